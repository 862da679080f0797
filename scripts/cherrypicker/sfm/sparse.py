"""The sparse stage: map the photos, judge the outcome, report on every photo."""

import logging
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import read_json, temporary_folder, write_json
from cherrypicker.photos import PHOTOS_COLUMN, photo_error
from cherrypicker.poses import write_poses
from cherrypicker.sfm.database import SCRATCH, copy_database
from cherrypicker.sfm.diagnosis import diagnose_photos
from cherrypicker.sfm.export import registered_photos, undistorted_poses, write_model
from cherrypicker.sfm.gps import compare_places, stated_places
from cherrypicker.sfm.mapping import Attempt, Mapper, MappingOptions
from cherrypicker.sfm.uncertainty import camera_uncertainty

logger = logging.getLogger(__name__)

# Median standard error of the cameras, a share of their distance, from which the photos do not hold
# one model together: 0.0001 to 0.0003 on three rings, 4 where parts have no common scale; half and
# twice as much tell these apart too
UNDETERMINED = 0.05
# Share of the largest error allowed from which on a used photo is named as doubtful (guess)
DOUBTFUL = 0.7


def reconstruct_sparse(
    database: str | os.PathLike,
    photos: Sequence[str | os.PathLike],
    listing: str | os.PathLike,
    model_folder: str | os.PathLike,
    report: str | os.PathLike,
    poses: str | os.PathLike,
    options: MappingOptions,
    *,
    masks: str | os.PathLike | None = None,
    seed: int = 0,
    threads: int = 1,
) -> None:
    """Map the photos and write model, poses and report.

    The database has verified matches, the photos lie in one folder; listing and masks are as of
    :func:`cherrypicker.sfm.features.extract_features`. COLMAP's binary files go to the model's
    folder, the registered photos' undistorted poses to an NPZ. The JSON report is written when too
    few photos register, too.

    A `StageError` where nothing registers, or less than ``min_registered_fraction``, or where the
    photos share so few points that parts of the model have no common scale.
    """
    if not photos:
        raise photo_error("no photo found in the folder")
    found, folder = read_json(listing), Path(photos[0]).parent
    with temporary_folder(Path(model_folder).parent, SCRATCH) as scratch:
        working = copy_database(database, scratch / "database.db")
        mapper = Mapper(working, folder, scratch, options, masks, seed, threads)
        best, *others = mapper.run()
        explained = diagnose_photos(best, found, doubtful_px=DOUBTFUL * mapper.limit_px)
    content = _report(best, others, explained)
    if best.n_registered:
        content["camera_std_fraction"] = describe(camera_uncertainty(best.model))
        centers = {each.name: each.projection_center() for each in registered_photos(best.model)}
        content["gps"] = compare_places(centers, stated_places(map(Path, photos)))
    write_json(report, content)
    _enforce(content, options.min_registered_fraction, folder)
    write_model(best.model, model_folder)
    write_poses(poses, undistorted_poses(best.model, best.errors))
    told = "{n_registered} of {n_photos} photos registered, {n_points:,} points, mean track "
    told += "{mean_track_length:.1f}, reprojection error {mean_reprojection_error_px:.2f} px"
    logger.info(told.format_map(content))


def _report(best: Attempt, others: Sequence[Attempt], explained: dict) -> dict:
    model = best.model
    cameras = {image.camera_id for image in registered_photos(model)}
    return {
        "n_photos": len(explained),
        "n_usable": best.n_photos,
        "n_registered": best.n_registered,
        "n_left_out": len(best.left_out),
        "camera_error_px": describe(best.errors),
        "registered_fraction": best.n_registered / max(best.n_photos, 1),
        "n_points": model.num_points3D(),
        "mean_track_length": model.compute_mean_track_length(),
        "mean_reprojection_error_px": None,  # of no photo
        **_fit(best),
        "attempt": best.name,
        "attempts": [
            {
                "name": attempt.name,
                "what": attempt.reason,
                "n_registered": attempt.n_registered,
                "n_left_out": len(attempt.left_out),
                "n_other_models": len(attempt.other_models),
                **_fit(attempt),
            }
            for attempt in (best, *others)
        ],
        "cameras": [
            {
                "model": camera.model_name,
                "width": camera.width,
                "height": camera.height,
                "params": np.asarray(camera.params).tolist(),
                "params_info": camera.params_info,
            }
            for camera in map(model.cameras.__getitem__, sorted(cameras))
        ],
        "photos": explained,
    }


def _fit(attempt: Attempt) -> dict:
    """How well a model agrees with its matches; nothing of none."""
    if not attempt.n_registered:
        return {}
    return {
        "pair_agreement": attempt.agreement,
        "mean_reprojection_error_px": attempt.model.compute_mean_reprojection_error(),
    }


def describe(errors: Mapping[str, float] | None) -> dict | None:
    """Median and largest error of a camera, and whose that is; None of none."""
    if not errors:
        return None
    worst = max(errors, key=lambda name: errors[name])
    return {"median": float(np.median([*errors.values()])), "max": errors[worst], "worst": worst}


def _enforce(content: dict, least: float, folder: Path) -> None:
    """Tell which photos are missing or in doubt; fail where too little registered, and why most.

    Or where parts of the model may shrink or turn against one another unnoticed.
    """
    missing = []
    for name, facts in content["photos"].items():
        if not facts["registered"]:
            logger.info("not in the model: %s: %s", name, facts["reason"])
            missing.append(facts["reason"].split(":")[0].split("(")[0].strip())
        elif facts["doubt"]:
            logger.info("doubtful: %s: %s", name, facts["doubt"])
    if missing:
        logger.warning("%d of %d photos are not in the model", len(missing), content["n_photos"])
    if not content["n_registered"] or content["registered_fraction"] < least:
        common = max(sorted(set(missing)), key=missing.count)
        raise StageError(
            f"{content['n_registered']} of {content['n_usable']} photos registered, "
            f"{100 * least:g} % are required; most frequent reason: {common}",
            file=folder,
            key=f"{PHOTOS_COLUMN}, sfm.min_registered_fraction or sfm.max_camera_error_px",
        )
    unsure = content["camera_std_fraction"]
    if unsure and unsure["median"] > UNDETERMINED:
        raise StageError(
            "the photos share too few points to hold one model together: parts of it have no "
            f"common scale (cameras unsure by {100 * unsure['median']:.0f} % of their distance, "
            f"{content['n_points']} points); photos must overlap more, or show more texture",
            file=folder,
            key=f"{PHOTOS_COLUMN} or sfm.max_features",
        )
