"""How sure a model's cameras are: the covariance of the adjustment.

Verified pairs say nothing of their own scale. Where the photos fall into parts that share too few
points, every pair fits, the reprojection error is small, and one part may still be half as large
as it should be. The covariance of the bundle adjustment knows: along such a change the error does
not grow.
"""

from __future__ import annotations

import numpy as np
import pycolmap

# Added to the diagonal of the reduced normal equations, so that a change without any resistance
# comes out as metres instead of as a failure; a ring of 66 photos does not notice 1e-2
DAMPING = 1e-6


def camera_uncertainty(model: pycolmap.Reconstruction) -> dict[str, float] | None:
    """Estimate the standard error of each camera's place.

    Returns
    -------
    dict or None
        Photo name to standard error, a share of the cameras' median distance from their middle,
        similarities of all cameras apart, for an error of each feature as large as the mean
        reprojection error; calibrations are held. None where the covariance cannot be had.
    """
    ids = sorted(model.reg_image_ids())
    covariance = _covariance(model, ids)
    if covariance is None:
        return None
    centers = np.array([model.images[i].projection_center() for i in ids])
    centers -= centers.mean(axis=0)
    free = _without_similarities(covariance, centers)
    variance = np.einsum("iaia->i", free.reshape(len(ids), 3, len(ids), 3))
    share = model.compute_mean_reprojection_error() / np.median(np.linalg.norm(centers, axis=1))
    errors = share * np.sqrt(np.maximum(variance, 0.0))
    return {model.images[i].name: float(error) for i, error in zip(ids, errors)}


def _covariance(model: pycolmap.Reconstruction, ids: list[int]) -> np.ndarray | None:
    """Covariance of the camera centres, (3 n, 3 n), with three points held, for 1 px."""
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
    if found is None:
        return None
    turns = [_center_by_pose(model.images[i].cam_from_world()) for i in ids]
    covariance = np.zeros((3 * len(ids), 3 * len(ids)))
    for a in range(len(ids)):
        for b in range(a, len(ids)):
            if a == b:
                block = found.get_cam_cov_from_world(ids[a])
            else:
                block = found.get_cam_cross_cov_from_world(ids[a], ids[b])
            if block is None:
                return None
            block = turns[a] @ block @ turns[b].T
            covariance[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] = block
            covariance[3 * b : 3 * b + 3, 3 * a : 3 * a + 3] = block.T
    return covariance


def _center_by_pose(pose: pycolmap.Rigid3d) -> np.ndarray:
    """How a camera's centre -R^T t moves with its pose (rotation, translation), (3, 6)."""
    R, (x, y, z) = pose.rotation.matrix(), pose.translation
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.hstack([-R.T @ cross, -R.T])


def _without_similarities(covariance: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Take shifts, turns and scale of all centres (n, 3) out of their covariance (3 n, 3 n)."""
    axes = np.eye(3)
    moves = [np.broadcast_to(axis, centers.shape).ravel() for axis in axes]
    moves += [np.cross(axis, centers).ravel() for axis in axes]
    basis, _ = np.linalg.qr(np.column_stack([*moves, centers.ravel()]))
    left = covariance - basis @ (basis.T @ covariance)
    return left - (left @ basis) @ basis.T
