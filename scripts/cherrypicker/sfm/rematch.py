"""Match photos once more by the poses of a model: pairs that it says overlap, along their lines.

Matching without poses finds few matches on bare twigs: the ratio test fails on texture that repeats
elsewhere in the photo. With poses a feature is compared with those near its epipolar line only, and
pairs count that could not be verified before.
"""

from __future__ import annotations

import logging
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.progress import Progress
from cherrypicker.sfm.guided import PhotoFeatures, guided_matches, read_features

logger = logging.getLogger(__name__)

# Half width of the band around an epipolar line, in mean reprojection errors of the model and in px
# at least: on the thinned rings 1.5 px where that error was 0.3 to 0.4 px.
BAND_ERRORS = 4.0
MIN_BAND_PX = 1.5
# A wrong match passes easily where few features lie in a band; on the thinned rings ratios of 0.6,
# 0.7, 0.8 and 0.9 left cameras 2.9, 2.3, 3.6 and 4.4 mm off (docs/sparse.md).
MAX_RATIO = 0.7
# SIFT hardly matches beyond; 70 degrees cost a third more and gave no better cameras.
MAX_ANGLE_DEG = 45.0
# Share of the model's points that two photos must see at such an angle to be tried.
MIN_SHARED = 0.02
# Photos that each is tried with, those that share most points: more than nearly all have in a scan
# of 66 photos, so that the pairs grow with the photos, not with their square.
N_PARTNERS = 30
# Points that stand for the model when pairs are chosen.
N_POINTS = 3000


def match_by_poses(
    model: pycolmap.Reconstruction, source: Path, target: Path, max_error_px: float, threads: int
) -> int:
    """Copy a database with the matches that a model's poses allow in place of its own.

    A pair whose verified matches contradict the poses (guided ones are less than half as many)
    keeps them, so that a model bent somewhere can still be pulled straight.

    Parameters
    ----------
    model : pycolmap.Reconstruction
    source, target : Path
        Database with features and verified matches, and the one to write.
    max_error_px : float
        Largest half width of the bands, px.
    threads : int

    Returns
    -------
    int
        Number of matches in ``target``.
    """
    shutil.copyfile(source, target)
    band = BAND_ERRORS * model.compute_mean_reprojection_error()
    band = min(max(band, MIN_BAND_PX), max_error_px)
    with pycolmap.Database.open(target) as database:
        verified = _verified(database, model)
        pairs = sorted(overlapping_pairs(model) | set(verified))
        features = {i: _features(database, model, i) for pair in pairs for i in pair}
        database.clear_two_view_geometries()

        def search(pair: tuple[int, int]) -> pycolmap.TwoViewGeometry:
            return _match_pair(model, pair, features, band)

        n_matches = 0
        with (
            ThreadPoolExecutor(threads) as pool,
            Progress(len(pairs), "pairs matched again by their poses") as bar,
        ):
            for pair, guided in zip(pairs, pool.map(search, pairs)):
                found = _less_contradicted(guided, verified.get(pair))
                if len(found.inlier_matches):
                    database.write_two_view_geometry(*pair, found)
                n_matches += len(found.inlier_matches)
                bar.step()
    logger.info(
        "matched again by poses, within %.1f px: %s matches of %d pairs became %s of %d",
        band,
        f"{sum(len(each.inlier_matches) for each in verified.values()):,}",
        len(verified),
        f"{n_matches:,}",
        len(pairs),
    )
    return n_matches


def _less_contradicted(
    guided: pycolmap.TwoViewGeometry, verified: pycolmap.TwoViewGeometry | None
) -> pycolmap.TwoViewGeometry:
    if verified is None or 2 * len(guided.inlier_matches) >= len(verified.inlier_matches):
        return guided
    return verified


def overlapping_pairs(model: pycolmap.Reconstruction) -> set[tuple[int, int]]:
    """Choose pairs of photo ids that see enough of the model's points from similar sides.

    Of those, each photo's ``N_PARTNERS`` that share most points.
    """
    points = np.array([point.xyz for _, point in sorted(model.points3D.items())]).reshape(-1, 3)
    points = points[:: max(len(points) // N_POINTS, 1)]
    ids = sorted(model.reg_image_ids())
    views = [_view(model, image_id, points) for image_id in ids]
    least = max(MIN_SHARED * len(points), 1)
    cosine = np.cos(np.radians(MAX_ANGLE_DEG))
    shared = np.zeros((len(views), len(views)), dtype=np.int64)
    for a, (seen_a, rays_a) in enumerate(views):
        for b in range(a + 1, len(views)):
            seen_b, rays_b = views[b]
            both = np.flatnonzero(seen_a & seen_b)
            shared[a, b] = (np.einsum("ni,ni->n", rays_a[both], rays_b[both]) > cosine).sum()
    shared += shared.T
    partners = np.argsort(-shared, axis=1, kind="stable")[:, :N_PARTNERS]
    return {
        (ids[min(a, b)], ids[max(a, b)])
        for a, row in enumerate(partners)
        for b in row
        if shared[a, b] >= least
    }


def _view(
    model: pycolmap.Reconstruction, image_id: int, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Tell which points lie in the picture, lens distortion apart; and the unit rays to all."""
    image = model.images[image_id]
    camera = model.cameras[image.camera_id]
    pose = np.array(image.cam_from_world().matrix())
    local = points @ pose[:, :3].T + pose[:, 3]
    pixels = local @ camera.calibration_matrix().T
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = pixels[:, :2] / pixels[:, 2:]
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    rays = local @ pose[:, :3]
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    return inside & (local[:, 2] > 0), rays


def _verified(
    database: pycolmap.Database, model: pycolmap.Reconstruction
) -> dict[tuple[int, int], pycolmap.TwoViewGeometry]:
    """Read the verified pairs among the registered photos, the smaller id first."""
    registered = set(model.reg_image_ids())
    pair_ids, geometries = database.read_two_view_geometries()
    pairs = [(a, b) for a, b in map(pycolmap.pair_id_to_image_pair, pair_ids)]
    return {
        pair: geometry
        for pair, geometry in zip(pairs, geometries)
        if len(geometry.inlier_matches) and registered.issuperset(pair)
    }


def _features(
    database: pycolmap.Database, model: pycolmap.Reconstruction, image_id: int
) -> PhotoFeatures:
    camera = model.cameras[model.images[image_id].camera_id]
    return read_features(database, image_id, camera)


def _match_pair(
    model: pycolmap.Reconstruction,
    pair: tuple[int, int],
    features: dict[int, PhotoFeatures],
    band_px: float,
) -> pycolmap.TwoViewGeometry:
    first, second = (model.images[i].cam_from_world() for i in pair)
    geometry = pycolmap.TwoViewGeometry()
    geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
    geometry.cam2_from_cam1 = second * first.inverse()
    geometry.E = pycolmap.essential_matrix_from_pose(geometry.cam2_from_cam1)
    geometry.inlier_matches = guided_matches(
        features[pair[0]],
        features[pair[1]],
        geometry,
        max_error_px=band_px,
        max_ratio=MAX_RATIO,
        max_distance=pycolmap.SiftMatchingOptions().max_distance,
    )
    return geometry
