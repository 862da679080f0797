"""How sure a model's cameras are: the covariance of the adjustment, and what half of it says.

Verified pairs say nothing of their own scale. Where the photos fall into parts that share too few
points, every pair fits, the reprojection error is small, and one part may still be half as large
as it should be. The covariance of the bundle adjustment knows: along such a change the error does
not grow. It knows nothing of wrong matches, which pull a model that few points hold: halves of the
points, adjusted by themselves, then disagree.
"""

from __future__ import annotations

import numpy as np
import pycolmap

from cherrypicker.sfm.refine import adjust_robustly
from cherrypicker.sfm.rematch import RefineOptions

# Random halves of the points (guess: their largest scatter moves by a quarter with the seed)
N_HALVES = 8
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
    centers = _centers(model, ids)
    free = _without_similarities(covariance, centers)
    variance = np.einsum("iaia->i", free.reshape(len(ids), 3, len(ids), 3))
    share = model.compute_mean_reprojection_error() / np.median(np.linalg.norm(centers, axis=1))
    errors = share * np.sqrt(np.maximum(variance, 0.0))
    return {model.images[i].name: float(error) for i, error in zip(ids, errors)}


def camera_scatter(
    model: pycolmap.Reconstruction, options: RefineOptions, *, seed: int = 0, threads: int = 1
) -> dict[str, float]:
    """Estimate the standard error of each camera's place by the delete-half jackknife.

    Each half of the points is adjusted from the poses found; the scatter of the halves is the
    standard error of the whole (Shao and Wu, Annals of Statistics 17, 1989). It is taken about the
    model's own cameras, not about the halves' mean: where two-view points have left the model
    since its adjustment, what they had moved counts. On thinned rings with cameras 75, 40, 17, 8
    and 7 mm off so 31, 37, 20, 15 and 6 mm are told, about the mean 13, 30, 6, 9 and 4.

    Returns
    -------
    dict
        As of :func:`camera_uncertainty`.
    """
    ids = sorted(model.reg_image_ids())
    centers = _centers(model, ids)
    point_ids = np.array(sorted(model.points3D))
    rng = np.random.default_rng(seed)
    basis = _similarities(centers)
    squares = np.zeros(len(ids))
    for _ in range(N_HALVES):
        half = pycolmap.Reconstruction(model)
        for point_id in rng.permutation(point_ids)[: len(point_ids) // 2]:
            half.delete_point3D(int(point_id))
        adjust_robustly(half, options, threads)
        moved = (_centers(half, ids) - centers).ravel()
        apart = (moved - basis @ (basis.T @ moved)).reshape(-1, 3)
        squares += np.einsum("ij,ij->i", apart, apart)
    size = np.median(np.linalg.norm(centers, axis=1))
    errors = np.sqrt(squares / N_HALVES) / size
    return {model.images[i].name: float(error) for i, error in zip(ids, errors)}


def _centers(model: pycolmap.Reconstruction, ids: list[int]) -> np.ndarray:
    """Camera centres from their middle, (n, 3)."""
    centers = np.array([model.images[i].projection_center() for i in ids])
    return centers - centers.mean(axis=0)


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
    basis = _similarities(centers)
    left = covariance - basis @ (basis.T @ covariance)
    return left - (left @ basis) @ basis.T


def _similarities(centers: np.ndarray) -> np.ndarray:
    """Orthonormal small shifts, turns and scale of all centres (n, 3), (3 n, 7)."""
    axes = np.eye(3)
    moves = [np.broadcast_to(axis, centers.shape).ravel() for axis in axes]
    moves += [np.cross(axis, centers).ravel() for axis in axes]
    return np.linalg.qr(np.column_stack([*moves, centers.ravel()]))[0]
