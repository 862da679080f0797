"""The last round: match again by the poses found, triangulate all anew, adjust robustly."""

from __future__ import annotations

import logging
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.sfm.export import registered_photos
from cherrypicker.sfm.rematch import RefineOptions, match_by_poses

logger = logging.getLogger(__name__)

# Least mean error that the last filter starts from, px: rendered photos may have none
LEAST_ERROR_PX = 1e-3


def refine_model(
    model: pycolmap.Reconstruction,
    database: Path,
    scratch: Path,
    max_error_px: float,
    options: RefineOptions,
    *,
    seed: int = 0,
    threads: int = 1,
) -> pycolmap.Reconstruction:
    """Match once more by the poses, triangulate all points anew, adjust all with a Cauchy loss.

    Two-view tracks take part in the adjustment, since on twigs they are most of what there is;
    :func:`drop_short_tracks` takes them out afterwards.

    Parameters
    ----------
    model : pycolmap.Reconstruction
        Left as it is.
    database : Path
        Database with features and verified matches, left as it is.
    scratch : Path
        Folder for a temporary database.
    max_error_px : float
        Largest epipolar error of a match, px.
    """
    refined = pycolmap.Reconstruction(model)
    matched = scratch / "by_poses.db"
    match_by_poses(refined, database, matched, max_error_px, options, threads)
    _triangulate(refined, matched, options, seed)
    matched.unlink()
    # A point triangulated from poses not yet adjusted may be off by more.
    manager = pycolmap.ObservationManager(refined)
    manager.filter_all_points3D(2 * options.filter_px, options.min_ray_angle_deg)
    adjust(refined, options, options.filter_errors, threads)
    return refined


def adjust(
    model: pycolmap.Reconstruction,
    options: RefineOptions,
    filter_errors: float = np.inf,
    threads: int = 1,
) -> None:
    """Adjust with a Cauchy loss; drop what does not fit or is seen from one side; adjust again.

    Mapping ends with a least-squares adjustment over observations of up to 4 px, which wrong
    matches pull.

    Parameters
    ----------
    model : pycolmap.Reconstruction
        Changed in place.
    filter_errors : float
        Largest error of an observation that stays, in mean reprojection errors; ``filter_px`` at
        most.
    """
    before = model.compute_num_observations()
    adjust_robustly(model, options, threads)
    error = max(model.compute_mean_reprojection_error(), LEAST_ERROR_PX)
    limit = min(options.filter_px, filter_errors * error)
    manager = pycolmap.ObservationManager(model)
    n_dropped = manager.filter_all_points3D(limit, options.min_ray_angle_deg)
    adjust_robustly(model, options, threads)
    logger.info(
        "adjusted: dropped %s of %s observations (%.1f %%), beyond %.1f px",
        f"{n_dropped:,}",
        f"{before:,}",
        100 * n_dropped / max(before, 1),
        limit,
    )


def adjust_robustly(model: pycolmap.Reconstruction, options: RefineOptions, threads: int) -> None:
    """Adjust poses, points and cameras in place, with a Cauchy loss."""
    wanted = pycolmap.BundleAdjustmentOptions()
    wanted.print_summary = False
    wanted.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    wanted.ceres.loss_function_scale = options.loss_scale_px
    wanted.ceres.use_gpu = False
    wanted.ceres.solver_options.max_num_iterations = options.n_adjustments
    wanted.ceres.solver_options.num_threads = threads
    pycolmap.bundle_adjustment(model, wanted)
    model.update_point_3d_errors()


def _triangulate(
    model: pycolmap.Reconstruction, database: Path, options: RefineOptions, seed: int
) -> None:
    """Replace the points by those that the database's matches and the poses give."""
    for point_id in list(model.points3D):
        model.delete_point3D(point_id)
    wanted = pycolmap.IncrementalTriangulatorOptions()
    wanted.random_seed = seed
    wanted.ignore_two_view_tracks = False
    focal = np.median([camera.mean_focal_length() for camera in model.cameras.values()])
    angle = float(np.degrees(options.max_ray_error_px / focal))
    wanted.create_max_angle_error = wanted.continue_max_angle_error = angle
    wanted.merge_max_reproj_error = wanted.complete_max_reproj_error = options.filter_px
    loading = pycolmap.DatabaseCacheOptions()
    loading.load_all_images = True
    loading.min_num_matches = 1
    with pycolmap.Database.open(database) as opened:
        cache = pycolmap.DatabaseCache.create(opened, loading)
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(model)
    for image_id in sorted(model.reg_image_ids()):
        mapper.triangulate_image(wanted, image_id)
    mapper.complete_and_merge_tracks(wanted)
    mapper.end_reconstruction(False)


def drop_short_tracks(model: pycolmap.Reconstruction) -> None:
    """Remove two-view points in place, but for those of photos that have no others.

    Two rays meet wherever along them the match was wrong: nothing vouches for such a point.
    """
    points = dict(model.points3D.items())
    longer = [point.track for point in points.values() if point.track.length() > 2]
    held = {element.image_id for track in longer for element in track.elements}
    for point_id, point in points.items():
        if point.track.length() <= 2 and held.issuperset(
            element.image_id for element in point.track.elements
        ):
            model.delete_point3D(point_id)


def drop_photos(model: pycolmap.Reconstruction, names: Collection[str]) -> None:
    """Take photos out of a model in place, with what they alone hold."""
    for image in registered_photos(model):
        if image.name in names:
            model.deregister_frame(image.frame_id)
    model.tear_down()
