"""How sure a model's cameras are: the covariance of the adjustment, and what half of it says.

Verified pairs say nothing of their own scale. Where the photos fall into parts that share too few
points, every pair fits, the reprojection error is small, and one part may still be half as large
as it should be. The covariance of the bundle adjustment knows: along such a change the error does
not grow. It knows nothing of wrong matches, which pull a model that few points hold: halves of the
points, adjusted by themselves, then disagree.
"""

import numpy as np
import pycolmap
from scipy.linalg import block_diag

from cherrypicker.sfm.places import centers_of, places_shown, shifts_of_places
from cherrypicker.sfm.refine import adjust_robustly

# Random halves of the points: 16 move the errors of two scans' cameras by 10 %, 4 by 15 %. And
# iterations of each: 30 take 2.6 times the time, and the errors of 86 photos are the same to 1 %
N_HALVES, N_ADJUSTMENTS = 8, 10
# Added to the diagonal of the reduced normal equations, so that a change without any resistance
# comes out as metres instead of as a failure; a ring of 66 photos does not notice 1e-2
DAMPING = 1e-6


def camera_uncertainty(model: pycolmap.Reconstruction) -> dict[str, float] | None:
    """Estimate the standard error of each camera's place, by the photo's name.

    It is a share of the cameras' median distance from their middle, similarities of all cameras
    apart, for an error of each feature as large as the mean reprojection error; calibrations are
    held. None where the covariance cannot be had.
    """
    ids = sorted(model.reg_image_ids())
    config = pycolmap.BundleAdjustmentConfig()
    for i in ids:
        config.add_image(i)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.THREE_POINTS)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_extra_params = False
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, model)
    wanted = pycolmap.BACovarianceOptions()
    wanted.params = pycolmap.BACovarianceOptionsParams.POSES
    wanted.damping = DAMPING
    found = pycolmap.estimate_ba_covariance(wanted, model, adjuster)
    if found is None or any(found.get_cam_cov_from_world(i) is None for i in ids):
        return None
    of_poses = np.block([[found.get_cam_cross_cov_from_world(a, b) for b in ids] for a in ids])
    gains = []  # how each centre -R^T t moves with its pose (rotation, translation), (3, 6)
    for i in ids:
        pose = model.images[i].cam_from_world()
        cross = np.cross(np.eye(3), pose.translation)
        gains.append(-pose.rotation.matrix().T @ np.hstack([cross, np.eye(3)]))
    gain = block_diag(*gains)
    covariance = gain @ of_poses @ gain.T
    centers = centers_of(model, ids)
    centers = centers - centers.mean(axis=0)
    # Shifts, turns and scale of all cameras together are no error
    moves = [np.broadcast_to(axis, centers.shape).ravel() for axis in np.eye(3)]
    moves += [np.cross(axis, centers).ravel() for axis in np.eye(3)]
    basis = np.linalg.qr(np.column_stack([*moves, centers.ravel()]))[0]
    left = covariance - basis @ (basis.T @ covariance)
    left = left - (left @ basis) @ basis.T
    variance = np.diagonal(left).reshape(-1, 3).sum(axis=1)
    share = model.compute_mean_reprojection_error() / np.median(np.linalg.norm(centers, axis=1))
    errors = share * np.sqrt(np.maximum(variance, 0.0))
    return {model.images[i].name: float(error) for i, error in zip(ids, errors)}


def tree_errors(model: pycolmap.Reconstruction, seed: int, threads: int) -> dict[str, float]:
    """Estimate by the delete-half jackknife how far each photo shows the tree beside its place.

    Each half of the points is adjusted from the poses found; the scatter of the halves is the
    standard error of the whole (Shao and Wu, Annals of Statistics 17, 1989). It is taken about the
    model's own cameras, not about the halves' mean: where two-view points have left the model
    since its adjustment, what they had moved counts. What scatters is where a photo shows places
    round the point that all look at, for they are what the later stages measure: a camera may be
    off along the rays of the few points that hold it, and they would never tell.

    By the photo's name, px of the photo as stored: the root mean square over the halves of the
    median over the places; infinite where no point holds the photo.
    """
    ids = sorted(model.reg_image_ids())
    places = places_shown(model)
    is_held = np.array([model.images[i].num_points3D > 0 for i in ids])
    point_ids = np.array(sorted(model.points3D))
    rng = np.random.default_rng(seed)
    squares = np.zeros(len(ids))
    for _ in range(N_HALVES):
        half = pycolmap.Reconstruction(model)
        for point_id in rng.permutation(point_ids)[: len(point_ids) // 2]:
            half.delete_point3D(int(point_id))
        adjust_robustly(half, threads, N_ADJUSTMENTS)
        squares += np.square(shifts_of_places(half, model, places))
    errors = np.where(is_held, np.sqrt(squares / N_HALVES), np.inf)
    return {model.images[i].name: float(error) for i, error in zip(ids, errors)}
