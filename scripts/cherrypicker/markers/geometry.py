"""Marker corners in space: ray intersection over all photos, outliers, and the side length.

Paper, section Scale Factor Estimator: each corner is the point with the least squared distance to
the rays through that corner in all photos (eq. objective). We add a consensus over photos before
it, and after it the minimisation of the reprojection error: once with four free corners, which
shows whether they form a square at all, and once with a square, whose single side length is known
better than the mean of four free ones, above all from few photos. By "mean" it is the paper alone:
the rays of all sightings, and the mean of the four sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.markers.sightings import PosedSightings

# All guesses. Pairs of photos that are tried (bounds the time), and their least parallax
_MAX_PAIRS = 600
_MIN_PARALLAX_DEG = 1.0
_TOLERANCE_SIDES = 0.02  # a sighting agrees within this share of its side
_N_ROUNDS = 5  # of refining the corners and asking again who agrees
# What the poses add to a corner's noise, px; beyond so many of both a residual loses influence
POSES_PX, _LOSS_SCALES = 0.25, 2.0
# What a square's corners may be off their plane and off a square, of its side, or as many errors
_MAX_OFF, _MAX_OFF_ERRORS = 0.02, 5
_LEAST_VARIANCE = 0.04  # of the residuals, in their noise: few photos may agree by chance


@dataclass(kw_only=True)
class Observations(PosedSightings):
    """Sightings of one marker."""

    corners: np.ndarray  # (n, 4, 2): normalised undistorted camera coordinates
    std: np.ndarray  # (n,): standard deviation of a corner coordinate, px
    side_px: np.ndarray  # (n,)

    @property
    def rays(self) -> np.ndarray:
        """Unit directions through the corners in the world, (n, 4, 3)."""
        return self.rays_through(self.corners)

    @property
    def middles(self) -> np.ndarray:
        """Where the diagonals cross, which is the square's middle from any side, (n, 2)."""
        corners = np.concatenate([self.corners, np.ones((*self.corners.shape[:2], 1))], axis=2)
        diagonals = np.cross(corners[:, :2], corners[:, 2:])  # (n, 2, 3): lines
        crossing = np.cross(diagonals[:, 0], diagonals[:, 1])
        return crossing[:, :2] / crossing[:, 2:]

    def residuals_px(self, corners: np.ndarray) -> np.ndarray:
        """Reprojection error of 3D corners (..., 4, 3) in each photo, px, shape (..., n, 4, 2)."""
        rotation, shift = self.cam_from_world[:, :, :3], self.cam_from_world[:, :, 3]
        in_camera = np.einsum("nij,...kj->...nki", rotation, corners) + shift[:, None, :]
        depth = in_camera[..., 2:]
        # A corner behind a camera is as wrong as can be, not an error of the division.
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        error = (in_camera[..., :2] / safe - self.corners) * self.focal[:, None, None]
        return np.where(depth > 0, error, 1e6)


@dataclass
class MarkerGeometry:
    """A marker in the frame of the poses."""

    corners: np.ndarray  # (4, 3): free corners, each from its own rays
    side_lengths: np.ndarray  # (4,): between neighbouring free corners
    # side, side_std: side of the best square, and its standard error
    side: float
    side_std: float
    inliers: np.ndarray  # (n,) bool: sightings that agree
    rms_px: float  # root mean square reprojection error of the free corners over the inliers, px
    # off_plane, off_square: largest distance of a corner from the common plane, and largest
    # deviation of a side or of a diagonal (over sqrt 2) from the mean side, both as fractions of
    # the side
    off_plane: float
    off_square: float
    is_square: bool  # whether both lie within what the noise allows
    # Mean squared residual of the best square in the noise that the fits expect of a sighting, but
    # for what moves all corners of a photo alike, which is its pose's; and its degrees of freedom
    misfit: float
    misfit_dof: int


def intersect_rays(
    origins: np.ndarray, directions: np.ndarray, weights: np.ndarray | None = None
) -> np.ndarray:
    """Point with the least (weighted) sum of squared distances to lines.

    Solves ``sum_j w_j (I - u_j u_j^T) (x - t_j) = 0`` (paper, eq. objective).

    Parameters
    ----------
    origins : ndarray of shape (..., n, 3)
    directions : ndarray of shape (..., n, 3)
        Unit vectors.
    weights : ndarray of shape (..., n), optional

    Returns
    -------
    ndarray of shape (..., 3)
        NaN where all lines are parallel.
    """
    projectors = np.eye(3) - directions[..., :, None] * directions[..., None, :]
    if weights is not None:
        projectors = projectors * weights[..., None, None]
    left = projectors.sum(axis=-3)
    right = np.einsum("...nij,...nj->...i", projectors, origins)
    scale = np.trace(left, axis1=-2, axis2=-1)[..., None, None]
    singular = np.abs(np.linalg.det(left / scale)) < 1e-12
    left = np.where(singular[..., None, None], np.eye(3), left)
    point = np.linalg.solve(left, right[..., None])[..., 0]
    return np.where(singular[..., None], np.nan, point)


def locate_marker(
    observations: Observations, *, max_error_px: float = 2.0, by: str = "square", seed: int = 0
) -> MarkerGeometry | None:
    """Find a marker's corners and side from its sightings, whatever outliers are among them.

    Parameters
    ----------
    max_error_px : float, default 2
        Largest reprojection error of a corner for its sighting to agree; at least 2 % of the side
        in that photo.
    by : {"square", "mean"}
        The side of the square that explains the sightings which agree; or the mean distance of the
        points that come nearest to the rays of all, as published.

    Returns
    -------
    MarkerGeometry or None
        None where no two photos agree on a position.
    """
    if by == "mean":
        centers = np.repeat(observations.centers[None], 4, axis=0)
        corners = intersect_rays(centers, observations.rays.transpose(1, 0, 2))
        if not np.isfinite(corners).all():
            return None
        found = _measured(observations, corners, np.ones(len(observations), bool))
        return replace(found, side=float(found.side_lengths.mean()))
    tolerance = _tolerance(observations, max_error_px)
    start = _consensus(observations, tolerance, seed)
    if start is None:
        return None
    corners, inliers = start, np.zeros(len(observations), bool)
    for _ in range(_N_ROUNDS):
        new = _agree(observations, corners, tolerance)
        if len(np.unique(observations.photos[new])) < 2:
            return None
        if (new == inliers).all():
            break
        inliers = new
        corners = _refine_corners(observations.select(inliers), corners)
    return _measured(observations, corners, inliers)


def _measured(
    observations: Observations, corners: np.ndarray, inliers: np.ndarray
) -> MarkerGeometry:
    """What the sightings that count say of a square at these corners."""
    used = observations.select(inliers)
    side, side_std, misfit, misfit_dof = _fit_square(used, corners)
    rms_px = float(np.sqrt(np.mean(np.sum(used.residuals_px(corners) ** 2, axis=-1))))
    noise = _MAX_OFF_ERRORS * rms_px / float(np.median(used.side_px)) / np.sqrt(len(used))
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    diagonals = np.linalg.norm(corners[:2] - corners[2:], axis=1) / np.sqrt(2)
    centered = corners - corners.mean(axis=0)
    off_plane = float(np.abs(centered @ np.linalg.svd(centered)[2][2]).max() / sides.mean())
    off_square = float(np.abs(np.concatenate([sides, diagonals]) / sides.mean() - 1).max())
    return MarkerGeometry(
        corners=corners,
        side_lengths=sides,
        side=side,
        side_std=side_std,
        inliers=inliers,
        rms_px=rms_px,
        off_plane=off_plane,
        off_square=off_square,
        is_square=max(off_plane, off_square) < max(_MAX_OFF, noise),
        misfit=misfit,
        misfit_dof=misfit_dof,
    )


def locate_middle(
    observations: Observations, *, max_error_px: float = 2.0, seed: int = 0
) -> tuple[np.ndarray, float] | None:
    """Find where most rays through the middles meet, for corners that no square explains.

    Parameters
    ----------
    max_error_px : float, default 2
        As of :func:`locate_marker`, of a middle.

    Returns
    -------
    (ndarray of shape (3,), float) or None
        The middle, and the radius of the print around it with the error of the middle; None where
        no two photos agree on a position.
    """
    middles = replace(observations, corners=observations.middles[:, None])
    tolerance = _tolerance(observations, max_error_px)
    place = _consensus(middles, tolerance, seed)
    if place is None:
        return None
    agree = _agree(middles, place, tolerance)
    if len(np.unique(observations.photos[agree])) < 2:
        return None
    used, middle = observations.select(agree), place[0]
    depth = used.depths(middle)
    reach = np.linalg.norm(used.corners - used.middles[:, None], axis=-1).max(axis=1) * depth
    rays = used.centers - middle
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    weights = (used.focal / (depth * _loss_scale(used)[:, 0, 0])) ** 2
    normal = np.einsum("n,nij->ij", weights, np.eye(3) - rays[:, :, None] * rays[:, None, :])
    error = np.sqrt(1 / np.linalg.eigvalsh(normal)[0])
    return middle, float(reach.max() + error)


def _tolerance(observations: Observations, max_error_px: float) -> np.ndarray:
    return np.maximum(max_error_px, _TOLERANCE_SIDES * observations.side_px)


def _agree(observations: Observations, corners: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    """Sightings all of whose corners lie within the tolerance."""
    errors = np.linalg.norm(observations.residuals_px(corners), axis=-1).max(axis=-1)
    return errors < tolerance


def _consensus(observations: Observations, tolerance: np.ndarray, seed: int) -> np.ndarray | None:
    """Corners by the pair of photos that most others agree with."""
    pairs = np.array(list(combinations(range(len(observations)), 2)))
    if len(pairs) == 0:
        return None
    pairs = pairs[observations.photos[pairs[:, 0]] != observations.photos[pairs[:, 1]]]
    rays, centers = observations.rays, observations.centers
    middle = rays.mean(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    cosine = np.einsum("pi,pi->p", middle[pairs[:, 0]], middle[pairs[:, 1]])
    pairs = pairs[cosine < np.cos(np.radians(_MIN_PARALLAX_DEG))]
    if len(pairs) == 0:
        return None
    pairs = thin_randomly(pairs, _MAX_PAIRS, seed)
    k = rays.shape[1]
    origins = np.repeat(centers[pairs][:, None], k, axis=1)  # (p, k, 2, 3)
    candidates = intersect_rays(origins, rays[pairs].transpose(0, 2, 1, 3))  # (p, k, 3)
    candidates = candidates[np.isfinite(candidates).all(axis=(1, 2))]
    if len(candidates) == 0:
        return None
    errors = np.linalg.norm(observations.residuals_px(candidates), axis=-1).max(axis=-1)
    # Each sighting counts less the worse it fits, so that equal counts are told apart.
    scores = np.clip(1 - (errors / tolerance) ** 2, 0, None).sum(axis=1)
    best = np.argmax(scores)
    agreeing = errors[best] < tolerance
    if len(np.unique(observations.photos[agreeing])) < 2:
        return None
    weights = np.repeat((observations.focal / observations.std)[None, agreeing], k, axis=0) ** 2
    return intersect_rays(
        np.repeat(centers[None, agreeing], k, axis=0),
        rays[agreeing].transpose(1, 0, 2),
        weights / weights.max(),
    )


def _loss_scale(used: Observations) -> np.ndarray:
    """Pixel noise floor of each sighting: its own corner noise, and the poses' error."""
    return np.hypot(used.std, POSES_PX)[:, None, None]


def _refine_corners(used: Observations, corners: np.ndarray) -> np.ndarray:
    """Four free corners by least reprojection error, robustly."""
    scale = _loss_scale(used)
    unit = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean()

    def residuals(flat: np.ndarray) -> np.ndarray:
        moved = corners + unit * flat.reshape(4, 3)
        return (used.residuals_px(moved) / scale).ravel()

    solution = least_squares(residuals, np.zeros(12), loss="soft_l1", f_scale=_LOSS_SCALES)
    return corners + unit * solution.x.reshape(4, 3)


def _fit_square(used: Observations, corners: np.ndarray) -> tuple[float, float, float, int]:
    """Side of the square with the least reprojection error, its standard error, and its misfit.

    The error is a sandwich estimate that takes each photo as one independent draw, since the four
    corners of a photo share the error of its pose; with few photos the plain one where larger.
    """
    unit_square = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    center = corners.mean(axis=0)
    rotation, _ = Rotation.align_vectors(corners - center, unit_square)
    start = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean()
    scale = _loss_scale(used)

    def residuals(parameters: np.ndarray) -> np.ndarray:
        side = start * np.exp(parameters[6])
        turned = (Rotation.from_rotvec(parameters[3:6]) * rotation).apply(unit_square)
        moved = center + start * parameters[:3] + side * turned
        return (used.residuals_px(moved) / scale).ravel()

    solution = least_squares(residuals, np.zeros(7), loss="soft_l1", f_scale=_LOSS_SCALES)
    side = float(start * np.exp(solution.x[6]))
    raw = residuals(solution.x)
    jacobian = solution.jac  # scaled by the robust loss
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    variance = max(np.sum(solution.fun**2) / max(len(raw) - 7, 1), _LEAST_VARIANCE)
    plain = variance * inverse[6, 6]
    n = len(used)
    blocks = np.einsum("nrp,nr->np", jacobian.reshape(n, 8, 7), solution.fun.reshape(n, 8))
    sandwich = (inverse @ (blocks.T @ blocks) @ inverse)[6, 6] * n / max(n - 1, 1)
    own = raw.reshape(n, 4, 2) - raw.reshape(n, 4, 2).mean(axis=1, keepdims=True)
    misfit_dof = 6 * n - 4  # a square's turn and side are fitted
    misfit = float(np.sum(own**2) / misfit_dof)
    return side, float(side * np.sqrt(max(plain, sandwich))), misfit, misfit_dof
