"""The last round: match again by the poses found, triangulate all anew, adjust robustly.

Matching without poses finds few matches on bare twigs: the ratio test fails on texture that repeats
elsewhere in the photo. With poses a feature is compared with those near its epipolar line only, and
pairs count that could not be verified before.
"""

import logging
from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.geometry.robust import CAUCHY
from cherrypicker.progress import in_threads
from cherrypicker.sfm.database import PairGeometries, verified_pairs
from cherrypicker.sfm.export import poses_of, registered_photos
from cherrypicker.sfm.guided import guided_matches, read_features
from cherrypicker.sfm.matching import MAX_ERROR_PX
from cherrypicker.sfm.places import places_shown, shifts_of_places

logger = logging.getLogger(__name__)

# Points that stand for the model when pairs are chosen: with half, twice as many and all of them 98
# of 100 pairs are the same on two scans
N_POINTS = 3000
# Least mean error that the last filter starts from, px: rendered photos may have none
LEAST_ERROR_PX = 1e-3
# Largest error of an observation that stays, px: the worst cameras of two scans are 4.6 and 1.6 mm
# off, with 1 px 6.0 and 1.9, with 4 px 5.6 and 1.8
FILTER_PX = 2.0
_MAPPER = pycolmap.IncrementalMapperOptions()


def refine_model(
    model: pycolmap.Reconstruction, database: Path, seed: int, threads: int
) -> pycolmap.Reconstruction:
    """Match once more by the poses, triangulate all points anew, adjust all with a Cauchy loss.

    It is done again while that moves the cameras by more than the features' noise, and each time
    less than half as far: a bent model finds its matches along bent epipolar lines, and the better
    ones only once it is straighter.

    Two-view tracks take part in the adjustment, since on twigs they are most of what there is; they
    go afterwards, and what they pulled at is adjusted without them.

    The model is left as it is; the file of the database, with features and verified matches, may be
    touched by COLMAP.
    """
    refined = pycolmap.Reconstruction(model)
    adjust(refined, threads=threads)
    shift = np.inf
    while True:
        before = pycolmap.Reconstruction(refined)
        _triangulate(refined, match_by_poses(refined, database, threads), seed)
        # A point triangulated from poses not yet adjusted may be off by more.
        manager = pycolmap.ObservationManager(refined)
        manager.filter_all_points3D(_MAPPER.filter_max_reproj_error, _MAPPER.filter_min_tri_angle)
        # On the thinned rings 1 px where the mean was 0.3 px took the largest error of a camera
        # from 10 to 8 mm
        adjust(refined, filter_errors=3.0, threads=threads)
        drop_short_tracks(refined)
        adjust_robustly(refined, threads)
        last = shift
        shift = float(np.median(shifts_of_places(before, refined, places_shown(refined))))
        noise = max(refined.compute_mean_reprojection_error(), LEAST_ERROR_PX)
        logger.info("cameras moved by %.2f px at the tree, noise %.2f px", shift, noise)
        if shift <= noise:
            return refined
        if not shift < last / 2:
            logger.warning("the cameras do not settle: matches move them by %.2f px", shift)
            return refined if shift < last else before


def match_by_poses(model: pycolmap.Reconstruction, database: Path, threads: int) -> PairGeometries:
    """Match the photos of a model along the epipolar lines of its poses.

    A pair whose verified matches contradict the poses (guided ones are less than half as many)
    keeps them, so that a model bent somewhere can still be pulled straight. The bands are at most
    `MAX_ERROR_PX` to each side. Returns the pairs in order, with their matches; none without any.
    """
    # On the thinned rings 1.5 px where the mean error was 0.3 to 0.4 px
    band = min(max(4.0 * model.compute_mean_reprojection_error(), 1.5), MAX_ERROR_PX)
    registered = set(model.reg_image_ids())
    with pycolmap.Database.open(database) as opened:
        verified = {
            pair: geometry
            for pair, geometry in verified_pairs(opened).items()
            if registered.issuperset(pair)
        }
        pairs = sorted(overlapping_pairs(model) | set(verified))
        cameras = {i: model.cameras[model.images[i].camera_id] for pair in pairs for i in pair}
        features = {i: read_features(opened, i, camera) for i, camera in cameras.items()}

    def search(pair: tuple[int, int]) -> pycolmap.TwoViewGeometry:
        first, second = (model.images[i].cam_from_world() for i in pair)
        guided = pycolmap.TwoViewGeometry()
        guided.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
        guided.cam2_from_cam1 = second * first.inverse()
        guided.E = pycolmap.essential_matrix_from_pose(guided.cam2_from_cam1)
        sides = features[pair[0]], features[pair[1]]
        # Few others lie in a band: ratios of 0.6, 0.7, 0.8 and 0.9 left cameras of the thinned
        # rings 2.9, 2.3, 3.6 and 4.4 mm off
        guided.inlier_matches = guided_matches(*sides, guided, band, max_ratio=0.7)
        own = verified.get(pair, guided)
        contradicts = 2 * len(guided.inlier_matches) < len(own.inlier_matches)
        return own if contradicts else guided

    results = in_threads(search, pairs, threads, "pairs matched again by their poses")
    matched = {pair: found for pair, found in zip(pairs, results) if len(found.inlier_matches)}
    n_before, n_after = (
        sum(len(each.inlier_matches) for each in some.values()) for some in (verified, matched)
    )
    logger.info(
        f"matched again by poses, within {band:.1f} px: {n_before:,} matches of {len(verified)} "
        f"pairs became {n_after:,} of {len(pairs)}"
    )
    return matched


def overlapping_pairs(model: pycolmap.Reconstruction) -> set[tuple[int, int]]:
    """Choose pairs of photo ids that see 2 % of the model's points or more from similar sides.

    SIFT hardly matches beyond 45 degrees; 70 cost a third more and gave no better cameras. Of those
    each photo's 30 that share most points, which are more than nearly all have in a scan of 66: so
    pairs grow with the photos, not with their square.
    """
    points = np.array([point.xyz for _, point in sorted(model.points3D.items())]).reshape(-1, 3)
    points = points[:: max(len(points) // N_POINTS, 1)]
    ids = np.array([image.image_id for image in registered_photos(model)])
    poses, ids = poses_of(model).select(np.argsort(ids)), np.sort(ids)
    seen = poses.frames(points)
    rays = points - poses.centers[:, None]  # (n_photos, n_points, 3)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    least, cosine = max(0.02 * len(points), 1), np.cos(np.radians(45.0))
    shared = np.zeros((len(ids), len(ids)), dtype=np.int64)
    for a, b in combinations(range(len(ids)), 2):
        both = np.flatnonzero(seen[a] & seen[b])
        shared[a, b] = (np.einsum("ni,ni->n", rays[a][both], rays[b][both]) > cosine).sum()
    shared += shared.T
    partners = np.argsort(-shared, axis=1, kind="stable")[:, :30]
    return {
        (int(ids[min(a, b)]), int(ids[max(a, b)]))
        for a, row in enumerate(partners)
        for b in row
        if shared[a, b] >= least
    }


def adjust(model: pycolmap.Reconstruction, filter_errors: float = np.inf, threads: int = 1) -> None:
    """Adjust with a Cauchy loss; drop what does not fit or is seen from one side; adjust again.

    Mapping ends with a least-squares adjustment over observations of up to 4 px, which wrong
    matches pull. The model changes in place; the largest error of an observation that stays is so
    many mean reprojection errors (``filter_errors``), and 2 px at most.
    """
    before = model.compute_num_observations()
    adjust_robustly(model, threads)
    error = max(model.compute_mean_reprojection_error(), LEAST_ERROR_PX)
    limit = min(FILTER_PX, filter_errors * error)
    manager = pycolmap.ObservationManager(model)
    n_dropped = manager.filter_all_points3D(limit, _MAPPER.filter_min_tri_angle)
    adjust_robustly(model, threads)
    logger.info(
        f"adjusted: dropped {n_dropped:,} of {before:,} observations "
        f"({100 * n_dropped / max(before, 1):.1f} %), beyond {limit:.1f} px"
    )


def adjust_robustly(model: pycolmap.Reconstruction, threads: int, n_iterations: int = 30) -> None:
    """Adjust poses, points and cameras in place, with a Cauchy loss of the model's own noise.

    The gain is in the first iterations, the loss is flat near the end.
    """
    # Of lengths of Gaussian errors in two directions the mean is sqrt(pi / 2) standard deviations
    noise = np.sqrt(2 / np.pi) * max(model.compute_mean_reprojection_error(), LEAST_ERROR_PX)
    wanted = pycolmap.BundleAdjustmentOptions()
    wanted.ceres.loss_function_scale = CAUCHY * noise
    wanted.print_summary = False
    wanted.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    wanted.ceres.use_gpu = False
    wanted.ceres.solver_options.max_num_iterations = n_iterations
    wanted.ceres.solver_options.num_threads = threads
    pycolmap.bundle_adjustment(model, wanted)
    model.update_point_3d_errors()


def _triangulate(model: pycolmap.Reconstruction, matches: PairGeometries, seed: int) -> None:
    """Replace the points by those that matches and the poses give."""
    for point_id in list(model.points3D):
        model.delete_point3D(point_id)
    wanted = pycolmap.IncrementalTriangulatorOptions()
    wanted.random_seed = seed
    wanted.ignore_two_view_tracks = False
    focal = np.median([camera.mean_focal_length() for camera in model.cameras.values()])
    angle = float(np.degrees(3.0 / focal))  # px of a ray; narrower cost observations
    wanted.create_max_angle_error = wanted.continue_max_angle_error = angle
    wanted.merge_max_reproj_error = wanted.complete_max_reproj_error = FILTER_PX
    graph = pycolmap.CorrespondenceGraph()
    ids = sorted(model.reg_image_ids())
    for image_id in ids:
        graph.add_image(image_id, model.images[image_id].num_points2D())
    for pair, geometry in matches.items():
        graph.add_two_view_geometry(*pair, geometry)
    graph.finalize()
    triangulator = pycolmap.IncrementalTriangulator(graph, model)
    for image_id in ids:
        triangulator.triangulate_image(wanted, image_id)
    triangulator.complete_all_tracks(wanted)
    triangulator.merge_all_tracks(wanted)


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
