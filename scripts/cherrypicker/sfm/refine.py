"""The last round: match again by the poses found, triangulate all anew, adjust robustly."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.sfm.rematch import match_by_poses

logger = logging.getLogger(__name__)

LOSS_SCALE_PX = 1.0
FILTER_PX = 2.0
# The last filter, in mean reprojection errors: on the thinned rings 1 px where that was 0.3 px took
# the largest error of a camera from 10 to 8 mm.
FILTER_ERRORS = 3.0
MIN_ANGLE_DEG = 1.5
# Largest error of a ray that founds or joins a track, px; narrower cost observations.
ANGLE_ERROR_PX = 3.0
# The gain is in the first iterations; the loss is flat near the end.
MAX_ITERATIONS = 30


def refine_model(
    model: pycolmap.Reconstruction,
    database: Path,
    scratch: Path,
    max_error_px: float,
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
    seed : int
    threads : int

    Returns
    -------
    pycolmap.Reconstruction
    """
    refined = pycolmap.Reconstruction(model)
    matched = scratch / "by_poses.db"
    match_by_poses(refined, database, matched, max_error_px, threads)
    _triangulate(refined, matched, seed)
    matched.unlink()
    # A point triangulated from poses not yet adjusted may be off by more.
    pycolmap.ObservationManager(refined).filter_all_points3D(2 * FILTER_PX, MIN_ANGLE_DEG)
    adjust(refined, FILTER_ERRORS, threads)
    return refined


def adjust(model: pycolmap.Reconstruction, filter_errors: float = np.inf, threads: int = 1) -> None:
    """Adjust poses, points and cameras with a Cauchy loss, drop what does not fit, adjust again.

    Mapping ends with a least-squares adjustment over observations of up to 4 px, which wrong
    matches pull.

    Parameters
    ----------
    model : pycolmap.Reconstruction
        Changed in place.
    filter_errors : float
        Largest error of an observation that stays, in mean reprojection errors; ``FILTER_PX`` at
        most.
    threads : int
    """
    before = model.compute_num_observations()
    _bundle(model, threads)
    limit = min(FILTER_PX, filter_errors * max(model.compute_mean_reprojection_error(), 1e-3))
    n_dropped = pycolmap.ObservationManager(model).filter_all_points3D(limit, MIN_ANGLE_DEG)
    _bundle(model, threads)
    logger.info(
        "adjusted: dropped %s of %s observations (%.1f %%), beyond %.1f px",
        f"{n_dropped:,}",
        f"{before:,}",
        100 * n_dropped / max(before, 1),
        limit,
    )


def _bundle(model: pycolmap.Reconstruction, threads: int) -> None:
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = LOSS_SCALE_PX
    options.ceres.use_gpu = False
    options.ceres.solver_options.max_num_iterations = MAX_ITERATIONS
    options.ceres.solver_options.num_threads = threads
    pycolmap.bundle_adjustment(model, options)
    model.update_point_3d_errors()


def _triangulate(model: pycolmap.Reconstruction, database: Path, seed: int) -> None:
    """Replace the points by those that the database's matches and the poses give."""
    for point_id in list(model.points3D):
        model.delete_point3D(point_id)
    options = pycolmap.IncrementalTriangulatorOptions()
    options.random_seed = seed
    options.ignore_two_view_tracks = False
    focal = np.median([camera.mean_focal_length() for camera in model.cameras.values()])
    angle = float(np.degrees(ANGLE_ERROR_PX / focal))
    options.create_max_angle_error = options.continue_max_angle_error = angle
    options.merge_max_reproj_error = options.complete_max_reproj_error = FILTER_PX
    loading = pycolmap.DatabaseCacheOptions()
    loading.load_all_images = True
    loading.min_num_matches = 1
    with pycolmap.Database.open(database) as opened:
        cache = pycolmap.DatabaseCache.create(opened, loading)
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(model)
    for image_id in sorted(model.reg_image_ids()):
        mapper.triangulate_image(options, image_id)
    mapper.complete_and_merge_tracks(options)
    mapper.end_reconstruction(False)


def drop_short_tracks(model: pycolmap.Reconstruction) -> None:
    """Remove two-view points in place, but for those of photos that have no others.

    Two rays meet wherever along them the match was wrong: nothing vouches for such a point.
    """
    longer = {
        image_id: sum(
            model.points3D[point.point3D_id].track.length() > 2
            for point in model.images[image_id].points2D
            if point.has_point3D()
        )
        for image_id in model.reg_image_ids()
    }
    for point_id, point in list(model.points3D.items()):
        if point.track.length() > 2:
            continue
        if all(longer[element.image_id] > 0 for element in point.track.elements):
            model.delete_point3D(point_id)
