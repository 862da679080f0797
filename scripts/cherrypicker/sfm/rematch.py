"""Match photos once more by the poses of a model: pairs that it says overlap, along their lines.

Matching without poses finds few matches on bare twigs: the ratio test fails on texture that repeats
elsewhere in the photo. With poses a feature is compared with those near its epipolar line only, and
pairs count that could not be verified before.
"""

from __future__ import annotations

import logging
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.placement.region import frames
from cherrypicker.progress import Progress
from cherrypicker.sfm.database import verified_pairs
from cherrypicker.sfm.export import poses_of, registered_photos
from cherrypicker.sfm.guided import guided_matches, read_features

logger = logging.getLogger(__name__)

# Points that stand for the model when pairs are chosen (guess).
N_POINTS = 3000


@dataclass(frozen=True)
class RefineOptions:
    """How the chosen model is matched once more, triangulated and adjusted."""

    # Half width of the band around an epipolar line, in mean reprojection errors and at least in
    # px: on the thinned rings 1.5 px where the mean error was 0.3 to 0.4 px
    band_errors: float = 4.0
    min_band_px: float = 1.5
    # Largest ratio of best to second best descriptor angle in a band, where few others lie: 0.6,
    # 0.7, 0.8 and 0.9 left cameras of the thinned rings 2.9, 2.3, 3.6 and 4.4 mm off
    rematch_ratio: float = 0.7
    # Angle at which two photos may see a point (SIFT hardly matches beyond 45; 70 cost a third more
    # and gave no better cameras), and the share of the points that they must see so
    max_pair_angle_deg: float = 45.0
    min_shared: float = 0.02
    # Photos that each is tried with, those that share most points: 30 are more than nearly all have
    # in a scan of 66, so that pairs grow with the photos, not with their square
    n_partners: int = 30
    # Scale of the Cauchy loss; largest error of an observation that stays (guesses)
    loss_scale_px: float = 1.0
    filter_px: float = 2.0
    # That error in mean reprojection errors, of the last filter: on the thinned rings 1 px where
    # the mean was 0.3 px took the largest error of a camera from 10 to 8 mm
    filter_errors: float = 3.0
    min_ray_angle_deg: float = 1.5  # least angle between the rays of a point, as COLMAP's mapper
    max_ray_error_px: float = (
        3.0  # of a ray that founds or joins a track; narrower cost observations
    )
    n_adjustments: int = 30  # iterations; the gain is in the first, the loss is flat near the end


def match_by_poses(
    model: pycolmap.Reconstruction,
    source: Path,
    target: Path,
    max_error_px: float,
    options: RefineOptions,
    threads: int,
) -> int:
    """Copy a database with the matches that a model's poses allow in place of its own.

    A pair whose verified matches contradict the poses (guided ones are less than half as many)
    keeps them, so that a model bent somewhere can still be pulled straight.

    Parameters
    ----------
    source, target : Path
        Database with features and verified matches, and the one to write.
    max_error_px : float
        Largest half width of the bands, px.

    Returns
    -------
    int
        Number of matches in ``target``.
    """
    shutil.copyfile(source, target)
    band = options.band_errors * model.compute_mean_reprojection_error()
    band = min(max(band, options.min_band_px), max_error_px)
    registered = set(model.reg_image_ids())
    with pycolmap.Database.open(target) as database:
        verified = {
            pair: geometry
            for pair, geometry in verified_pairs(database).items()
            if registered.issuperset(pair)
        }
        pairs = sorted(overlapping_pairs(model, options) | set(verified))
        cameras = {i: model.cameras[model.images[i].camera_id] for pair in pairs for i in pair}
        features = {i: read_features(database, i, camera) for i, camera in cameras.items()}
        database.clear_two_view_geometries()

        def search(pair: tuple[int, int]) -> pycolmap.TwoViewGeometry:
            first, second = (model.images[i].cam_from_world() for i in pair)
            guided = pycolmap.TwoViewGeometry()
            guided.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            guided.cam2_from_cam1 = second * first.inverse()
            guided.E = pycolmap.essential_matrix_from_pose(guided.cam2_from_cam1)
            sides = features[pair[0]], features[pair[1]]
            guided.inlier_matches = guided_matches(*sides, guided, band, options.rematch_ratio)
            own = verified.get(pair, guided)
            contradicts = 2 * len(guided.inlier_matches) < len(own.inlier_matches)
            return own if contradicts else guided

        n_matches = 0
        with (
            ThreadPoolExecutor(threads) as pool,
            Progress(len(pairs), "pairs matched again by their poses") as bar,
        ):
            for pair, found in zip(pairs, pool.map(search, pairs)):
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


def overlapping_pairs(
    model: pycolmap.Reconstruction, options: RefineOptions
) -> set[tuple[int, int]]:
    """Choose pairs of photo ids that see enough of the model's points from similar sides.

    Of those, each photo's ``n_partners`` that share most points.
    """
    points = np.array([point.xyz for _, point in sorted(model.points3D.items())]).reshape(-1, 3)
    points = points[:: max(len(points) // N_POINTS, 1)]
    ids = np.array([image.image_id for image in registered_photos(model)])
    poses, ids = poses_of(model).select(np.argsort(ids)), np.sort(ids)
    seen = [frames(poses, i, points, 0.0) for i in range(len(poses))]
    rays = points - poses.centers[:, None]  # (n_photos, n_points, 3)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    least = max(options.min_shared * len(points), 1)
    cosine = np.cos(np.radians(options.max_pair_angle_deg))
    shared = np.zeros((len(ids), len(ids)), dtype=np.int64)
    for a, b in combinations(range(len(ids)), 2):
        both = np.flatnonzero(seen[a] & seen[b])
        shared[a, b] = (np.einsum("ni,ni->n", rays[a][both], rays[b][both]) > cosine).sum()
    shared += shared.T
    partners = np.argsort(-shared, axis=1, kind="stable")[:, : options.n_partners]
    return {
        (int(ids[min(a, b)]), int(ids[max(a, b)]))
        for a, row in enumerate(partners)
        for b in row
        if shared[a, b] >= least
    }
