"""Scale factor of a reconstruction from markers of known side length.

Paper, section Scale Factor Estimator: ``s = d_aruco / d_scene``. Several markers, of several sizes,
are joined by their inverse variance; one that contradicts the others is left out and reported.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.markers.columns import (
    CAMERA_DISTANCE_M,
    SIDES_COLUMN,
    check_scale_columns,
    choose_mode,
)
from cherrypicker.markers.detection import (
    Detection,
    detect_markers,
    marker_dictionary,
    suggest_dictionaries,
)
from cherrypicker.markers.geometry import Observations, locate_marker

logger = logging.getLogger(__name__)

# Guesses. Printers and rulers: two correct markers may differ by this much, or so many errors
_PRINT_TOLERANCE, _TOLERANCE_ERRORS = 0.005, 4
_WORST_DISAGREEMENT = 0.03  # of two markers that the scale survives
_LEAST_RELATIVE_STD, _MAX_RELATIVE_STD = 1e-4, 0.05


def estimate_scale(
    photos: Sequence[str | Path],
    reconstruction: Any,
    *,
    cell: str,
    mode: str,
    dictionary: str,
    sides_m: str,
    min_images: int,
    max_reprojection_px: float,
    threads: int = 1,
    seed: int = 0,
) -> dict:
    """Scale of a sparse model, as the content of scale.json.

    Parameters
    ----------
    photos : list of path-like
        The tree's photos; those that are not registered are left out.
    cell, mode : str
        As for :func:`cherrypicker.markers.columns.choose_mode`.
    dictionary, sides_m : str
        The columns ``marker_dictionary`` and ``marker_sides_m``.
    min_images : int
        Photos that must agree on a marker.

    Raises
    ------
    StageError
        If markers are asked for but not described, not found, or contradict each other.
    """
    mode, value = choose_mode(cell, mode)
    if mode != "marker":
        logger.info("scale: %s%s", mode, "" if value is None else f", {value:g} metres per unit")
        return _without_markers(mode, value)
    sides = check_scale_columns(cell, "marker", dictionary, sides_m)
    views = _views(photos, reconstruction)
    detections, other_ids = detect_markers(
        [view[0] for view in views],
        [view[1] for view in views],
        marker_dictionary(dictionary),
        list(sides),
        threads=threads,
    )
    cam_from_world = np.array([view[2] for view in views])
    _check_found(detections, other_ids, [view[0] for view in views], dictionary, sides, min_images)
    warnings: list[str] = []
    markers = [
        _measure_marker(
            marker_id,
            side,
            [detection for detection in detections if detection.marker_id == marker_id],
            cam_from_world,
            min_images=min_images,
            max_px=max_reprojection_px,
            seed=seed,
        )
        for marker_id, side in sides.items()
    ]
    for marker in markers:
        marker["images"] = [Path(views[index][0]).name for index in marker["images"]]
    scale, scale_std = combine_markers(markers, warnings)
    _check_plausible(scale, scale_std, cam_from_world, markers, warnings)
    used = [marker for marker in markers if marker["used"]]
    for warning in warnings:
        logger.warning("%s", warning)
    logger.info(
        "scale: %.6g +- %.2g metres per unit (%.2f %%) from %d marker(s)",
        scale,
        scale_std,
        100 * scale_std / scale,
        len(used),
    )
    return {
        "mode": "marker",
        "unit": "m",
        "scale": scale,
        "scale_std": scale_std,
        "n_images": len({name for marker in used for name in marker["images"]}),
        "n_rays": sum(marker["n_rays"] for marker in used),
        "dictionary": dictionary,
        "markers": markers,
        "other_ids": {str(marker_id): count for marker_id, count in other_ids.items()},
        "warnings": warnings,
    }


def _without_markers(mode: str, value: float | None) -> dict:
    return {
        "mode": mode,
        "unit": "m" if mode == "number" else "arbitrary",
        "scale": value,
        "scale_std": None,
        "n_images": 0,
        "n_rays": 0,
        "markers": [],
        "warnings": [],
    }


def _views(photos: Sequence[str | Path], reconstruction: Any) -> list[tuple]:
    """Path, camera and pose (3, 4) of each registered photo, by name."""
    paths = {Path(path).name: path for path in photos}
    views = []
    for image in sorted(reconstruction.images.values(), key=lambda image: image.name):
        name = Path(image.name).name
        if not image.has_pose or name not in paths:
            continue
        camera = reconstruction.cameras[image.camera_id]
        views.append((paths[name], camera, image.cam_from_world().matrix()))
    if len(views) < 2:
        raise StageError(
            f"only {len(views)} of the photos are registered in the sparse model",
            key="sfm.min_registered_fraction",
        )
    return views


def _check_found(
    detections: list[Detection],
    other_ids: dict[int, int],
    photos: Sequence[str | Path],
    dictionary: str,
    sides: dict[int, float],
    min_images: int,
) -> None:
    """Refuse when no listed marker is seen often enough, with what may help."""
    counts = {
        marker_id: len({d.photo for d in detections if d.marker_id == marker_id})
        for marker_id in sides
    }
    for marker_id, count in counts.items():
        logger.info("marker %d: seen in %d of %d photos", marker_id, count, len(photos))
    if max(counts.values()) >= min_images:
        return
    seen = ", ".join(f"{marker_id} in {count}" for marker_id, count in counts.items())
    hint = ""
    if other_ids:
        listed = ", ".join(f"{marker_id} ({count})" for marker_id, count in other_ids.items())
        hint = f"; other ids of {dictionary} were seen, in so many photos: {listed}"
    elif max(counts.values()) == 0:
        suggestion = suggest_dictionaries(photos)
        hint = f"; {suggestion}" if suggestion else ""
    raise StageError(
        f"no marker is seen in {min_images} photos or more (marker {seen} of {len(photos)}){hint}",
        key=f"marker_dictionary, {SIDES_COLUMN}; or scale",
    )


def _measure_marker(
    marker_id: int,
    side_m: float,
    detections: list[Detection],
    cam_from_world: np.ndarray,
    *,
    min_images: int,
    max_px: float,
    seed: int,
) -> dict:
    """Geometry and scale of one marker as a plain dictionary; `used` says whether it counts."""
    report: dict[str, Any] = {
        "id": marker_id,
        "side_m": side_m,
        "n_images": len({detection.photo for detection in detections}),
        "n_detections": len(detections),
        "n_inliers": 0,
        "n_rays": 0,
        "used": False,
        "flags": [],
        "images": [],
    }
    precise = [detection for detection in detections if detection.is_precise]
    if len({detection.photo for detection in precise}) >= max(min_images, 2):
        detections = precise
    elif detections:
        report["flags"].append(
            "coarse corners: the paper is not flat, or the pattern is blurred or covered"
        )
    if len({detection.photo for detection in detections}) < min_images:
        report["flags"].append(f"seen in fewer than {min_images} photos")
        return report
    observations = Observations(
        photos=np.array([detection.photo for detection in detections]),
        cam_from_world=cam_from_world[[detection.photo for detection in detections]],
        corners=np.array([detection.corners for detection in detections]),
        focal=np.array([detection.focal for detection in detections]),
        std=np.array([detection.corner_std for detection in detections]),
        side_px=np.array([detection.side_px for detection in detections]),
    )
    geometry = locate_marker(observations, max_error_px=max_px, seed=seed)
    if geometry is None or len(np.unique(observations.photos[geometry.inliers])) < min_images:
        report["flags"].append("its sightings do not agree on a position")
        return report
    outliers = len(observations) - int(geometry.inliers.sum())
    if outliers:
        report["flags"].append(f"{outliers} of {len(observations)} sightings do not fit")
    if not geometry.is_square:
        report["flags"].append(
            f"its corners do not form a flat square (off the plane {100 * geometry.off_plane:.1f} "
            f"%, off the square {100 * geometry.off_square:.1f} % of the side)"
        )
    return report | {
        "n_inliers": int(geometry.inliers.sum()),
        "n_rays": 4 * int(geometry.inliers.sum()),
        "used": True,
        "is_square": bool(geometry.is_square),
        "images": sorted({int(index) for index in observations.photos[geometry.inliers]}),
        "corners": geometry.corners,
        "side_lengths": geometry.side_lengths,
        "mean_side": float(geometry.side_lengths.mean()),
        "square_side": geometry.side,
        "rms_reprojection_px": geometry.rms_px,
        "mean_side_px": float(observations.side_px[geometry.inliers].mean()),
        "off_plane": geometry.off_plane,
        "off_square": geometry.off_square,
        "scale": side_m / geometry.side,
        "scale_std": side_m * geometry.side_std / geometry.side**2,
    }


def combine_markers(markers: list[dict], warnings: list[str]) -> tuple[float, float]:
    """Weighted mean of the markers' scales; changes their ``used`` and ``flags``.

    Parameters
    ----------
    markers : list of dict
        With ``scale``, ``scale_std``, ``is_square`` where ``used``.
    warnings : list of str
        Gets a line per marker that is left out or doubtful.

    Returns
    -------
    scale, scale_std : float

    Raises
    ------
    StageError
        If no marker is usable, or if two contradict each other and nothing says which is right.
    """
    measured = [marker for marker in markers if marker["used"]]
    if not measured:
        reasons = "; ".join(f"marker {m['id']}: {', '.join(m['flags'])}" for m in markers)
        raise StageError(f"no marker gives a scale ({reasons})", key=SIDES_COLUMN)
    square = [marker for marker in measured if marker["is_square"]]
    if square:
        for marker in measured:
            if not marker["is_square"]:
                _drop(marker, "bent or wrongly found", warnings)
        measured = square
    else:
        warnings.append(
            "the markers' corners do not form flat squares: is the marker bent, or the "
            "reconstruction warped?"
        )
    measured = _drop_contradicting(measured, warnings)
    values = np.array([marker["scale"] for marker in measured])
    stds = np.hypot([marker["scale_std"] for marker in measured], _LEAST_RELATIVE_STD * values)
    weights = 1 / np.hypot(stds, _PRINT_TOLERANCE / 2 * values * (len(values) > 1)) ** 2
    scale = float(np.sum(weights * values) / weights.sum())
    variance = float(np.sum(weights**2 * stds**2) / weights.sum() ** 2)
    if len(values) > 1:
        # What the markers differ by beyond their own errors is part of the uncertainty.
        spread = np.sum(weights * (values - scale) ** 2) / weights.sum() / (len(values) - 1)
        variance = max(variance, float(spread))
    for marker in measured:
        if not marker["is_square"]:
            variance = max(variance, (0.5 * marker["off_square"] * scale) ** 2)
    return scale, float(np.sqrt(variance))


def _drop_contradicting(measured: list[dict], warnings: list[str]) -> list[dict]:
    """Leave out markers that differ from the median of three and more."""
    while len(measured) > 1:
        values = np.array([marker["scale"] for marker in measured])
        stds = np.array([marker["scale_std"] for marker in measured])
        middle = np.median(values)
        off = np.abs(values / middle - 1)
        allowed = np.maximum(_PRINT_TOLERANCE, _TOLERANCE_ERRORS * stds / values)
        if len(measured) == 2:
            off = np.full(2, abs(values[0] - values[1]) / middle)
            allowed = np.full(2, np.hypot(*allowed))
        if (off <= allowed).all():
            break
        text = ", ".join(f"marker {m['id']} gives {m['scale']:.5g}" for m in measured)
        if len(measured) == 2:
            message = f"the markers contradict each other by {100 * off[0]:.1f} %: {text}"
            if off[0] > _WORST_DISAGREEMENT:
                raise StageError(f"{message}; check their sides", key=SIDES_COLUMN)
            warnings.append(message)
            break
        worst = int(np.argmax(off / allowed))
        reason = f"it differs by {100 * off[worst]:.1f} % from the others' scale"
        _drop(measured[worst], reason, warnings)
        measured = [marker for index, marker in enumerate(measured) if index != worst]
    return measured


def _drop(marker: dict, reason: str, warnings: list[str]) -> None:
    marker["used"] = False
    marker["flags"].append(f"left out: {reason}")
    warnings.append(f"marker {marker['id']} is left out: {reason}")


def _check_plausible(
    scale: float,
    scale_std: float,
    cam_from_world: np.ndarray,
    markers: list[dict],
    warnings: list[str],
) -> None:
    """Refuse scales under which the photographer stood impossibly near or far."""
    rotation, shift = cam_from_world[:, :, :3], cam_from_world[:, :, 3]
    centers = -np.einsum("nji,nj->ni", rotation, shift)
    corners = np.concatenate([marker["corners"] for marker in markers if marker["used"]])
    distance = float(scale * np.median(np.linalg.norm(centers - corners.mean(axis=0), axis=1)))
    low, high = CAMERA_DISTANCE_M
    if not low <= distance <= high:
        raise StageError(
            f"the cameras would stand {distance:.3g} m from the marker: are the sides in metres?",
            key=SIDES_COLUMN,
        )
    logger.info("the cameras' median distance to the markers is %.2f m", distance)
    if scale_std > _MAX_RELATIVE_STD * scale:
        warnings.append(
            f"the scale is known only to {100 * scale_std / scale:.0f} %: show the marker in more "
            "photos from more directions"
        )
    for marker in markers:
        for flag in marker["flags"]:
            logger.info("marker %d: %s", marker["id"], flag)
