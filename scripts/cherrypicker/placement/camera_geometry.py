"""What the camera poses alone say about a scene: the point looked at, and which way is up.

A photo may be stored in any of four quarter turns (COLMAP ignores the EXIF orientation), so an
image's own "up" is trusted only up to such a turn; the turns are chosen by consensus of all photos,
with EXIF as a hint.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cherrypicker.geometry.robust import robust_sigma
from cherrypicker.placement.region import crossing, find_region
from cherrypicker.poses import Poses

# Right and up of the photographer in camera axes (x right, y down) for each quarter turn of the
# stored image. 0: as stored; 1: EXIF 6, up is the image's left; 2: upside down, EXIF 3; 3: EXIF 8.
_RIGHT_AXES = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
_UP_AXES = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
# Rows: the turn that EXIF states (none or upright, 1, 2, 3). A mild preference that decides where
# geometry cannot, as for a ring of level portrait photos; the tag may be missing or wrong.
_TURN_COST = np.array(
    [
        [0.0, 0.12, 0.5, 0.15],
        [0.15, 0.0, 0.3, 0.5],
        [0.3, 0.3, 0.0, 0.3],
        [0.15, 0.5, 0.3, 0.0],
    ]
)
_TURN_OF_EXIF = {1: 0, 6: 1, 3: 2, 8: 3}
_ROLL_SCALE_DEG = 8.0  # of hand-held photos (guess)
_PITCH_SCALE_DEG = 45.0
# Photographers share habits: no number of photos makes the vertical better than this (guess)
_UP_FLOOR_DEG = 0.25
# Weight of the depth at which the cloud is seen, in axes: that of a spread of 6 degrees, below
# which the axes tell no depth (region.LEAST_SPREAD).
_DEPTH_PULL = 0.01
# What a photo's middle shows: its middle half each way, of so many points, so many in it (guesses)
_MIDDLE, _SAMPLE, _FEWEST_SEEN = 0.25, 4000, 5
# Search of the vertical (guesses): pairs of photos; the sine below which their axes are parallel
_N_PAIRS, _PARALLEL = 400, 0.05
_N_ROUNDS = 15
_LEAST_SPREAD_DEG = 0.2
_OUTLIER = 2.5  # spreads at which a photo's weight has fallen to a quarter
_RIDGE = 1e-3
_SMALL_SAMPLE = 4.0  # adds this over the number of photos to the variance


@dataclass(frozen=True)
class CameraUp:
    """Vertical direction that the camera rolls agree on."""

    up: np.ndarray  # (3,): unit vector, world frame
    # (n_cameras,) int: quarter turn of each photo, 0 stored upright, 1 EXIF 6, 2 upside down, 3
    # EXIF 8
    turns: np.ndarray
    # (3, 3): of `up` in rad^2, zero along `up` itself; large where the views do not determine it
    covariance: np.ndarray
    roll_std_deg: float  # robust spread of the camera rolls about `up`, degrees
    cost: float  # mean robust disagreement in [0, 1]; below 0.3 the cameras agree well


def unit(vectors: ArrayLike) -> np.ndarray:
    """Scale vectors of shape (..., 3) to length one."""
    vectors = np.asarray(vectors, float)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def angle_deg(a: ArrayLike, b: ArrayLike) -> float:
    """Angle between two vectors in degrees, precise near zero."""
    a, b = unit(a), unit(b)
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def tangent_basis(direction: ArrayLike) -> np.ndarray:
    """Two unit vectors, shape (2, 3), that span the plane orthogonal to `direction`."""
    direction = unit(direction)
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    first = unit(np.cross(direction, helper))
    return np.stack([first, np.cross(direction, first)])


def look_at_point(poses: Poses, points: np.ndarray) -> tuple[np.ndarray, float]:
    """Point that the cameras look at: the centre of their region of interest.

    Where they look at no common place (a walk along a row) their axes leave the depth open; a weak
    pull towards the depth at which each camera sees the cloud closes it.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3)
        The cloud, in the frame of the poses.

    Returns
    -------
    point : ndarray of shape (3,)
    distance : float
        Median distance of the cameras to it: the unit of thresholds where no scale is known.
    """
    region = find_region(poses)
    if region is not None:
        return region.center, region.distance
    point, _ = crossing(poses, prior=_mean_seen_point(poses, points), pull=_DEPTH_PULL)
    return point, float(np.median(np.linalg.norm(point - poses.centers, axis=1)))


def _mean_seen_point(poses: Poses, points: np.ndarray) -> np.ndarray:
    """Median over the cameras of the axis point at the depth of what the photo's middle shows."""
    step = max(1, len(points) // _SAMPLE)
    sample = np.asarray(points)[::step]
    seen = []
    for index in range(len(poses.names)):
        pixels, depth = poses.project(sample, index)
        size = np.array([poses.width[index], poses.height[index]])
        central = (depth > 0) & np.all(np.abs(pixels - size / 2) < size * _MIDDLE, axis=1)
        if central.sum() >= _FEWEST_SEEN:
            seen.append(poses.centers[index] + np.median(depth[central]) * poses.forward[index])
    return np.median(seen, axis=0) if seen else np.median(sample, axis=0)


def turns_from_exif(orientations: Iterable[int]) -> np.ndarray:
    """Quarter turns, shape (n,), that EXIF orientations (1 to 8) state; mirrored count as 1."""
    return np.array([_TURN_OF_EXIF.get(int(value), 0) for value in orientations], int)


def roll_costs(
    poses: Poses, directions: ArrayLike, stated_turns: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """How badly each photo fits each hypothetical up direction, at its best quarter turn.

    A level photo has its right axis orthogonal to up (roll) and its up axis not too far from up
    (pitch); the second term rejects the horizontal directions to which the image axes of a level
    ring of cameras are orthogonal as well.

    Parameters
    ----------
    directions : ndarray of shape (n_directions, 3)
    stated_turns : ndarray of shape (n_cameras,), int, optional
        As :func:`turns_from_exif` gives them; all 0 without.

    Returns
    -------
    costs : ndarray of shape (n_directions, n_cameras)
        In [0, 1), robust.
    turns : ndarray of shape (n_directions, n_cameras), int
    """
    right, up = photographer_axes(poses)
    directions = unit(np.atleast_2d(directions))
    sin_roll = np.einsum("nki,hi->hnk", right, directions)
    cos_pitch = np.einsum("nki,hi->hnk", up, directions)
    roll = np.degrees(np.arcsin(np.clip(np.abs(sin_roll), 0, 1)))
    pitch = np.degrees(np.arccos(np.clip(cos_pitch, -1, 1)))
    squared = (roll / _ROLL_SCALE_DEG) ** 2 + (pitch / _PITCH_SCALE_DEG) ** 2
    misfit = squared / (1.0 + squared)
    if stated_turns is None:
        stated_turns = np.zeros(len(right), int)
    costs = misfit + _TURN_COST[stated_turns] * (1.0 - misfit)
    return costs.min(axis=2), costs.argmin(axis=2)


def photographer_axes(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Right and up axes of every photo at each quarter turn, world, each (n_cameras, 4, 3)."""
    world_from_cam = np.transpose(poses.cam_from_world[:, :, :3], (0, 2, 1))
    right = np.einsum("nij,kj->nki", world_from_cam, _RIGHT_AXES)
    up = np.einsum("nij,kj->nki", world_from_cam, _UP_AXES)
    return right, up


def camera_up(
    poses: Poses,
    *,
    stated_turns: np.ndarray | None = None,
    start: np.ndarray | None = None,
    seed: int = 0,
) -> CameraUp:
    """Estimate the vertical from the camera rolls.

    Every photo contributes its horizontal axis (image x, or y for a portrait photo stored
    sideways), which ought to be orthogonal to up whatever the pitch. A roll bias that all photos of
    a ring share cancels out.

    Parameters
    ----------
    stated_turns : ndarray of shape (n_cameras,), int, optional
        Quarter turns according to EXIF.
    start : ndarray of shape (3,), optional
        Take the solution near this direction (a ground normal, sign included); else search all.
    """
    if start is None:
        hypotheses = _up_hypotheses(poses, np.random.default_rng(seed))
        costs, _ = roll_costs(poses, hypotheses, stated_turns)
        start = hypotheses[np.argmin(costs.mean(axis=1))]
    direction = unit(start)
    right_axes, _ = photographer_axes(poses)
    rows = np.arange(len(right_axes))
    for _ in range(_N_ROUNDS):
        costs, turns = roll_costs(poses, direction, stated_turns)
        right = right_axes[rows, turns[0]]
        direction, covariance, spread = _solve_vertical(right, direction)
    costs, turns = roll_costs(poses, direction, stated_turns)
    return CameraUp(direction, turns[0], covariance, spread, float(costs.mean()))


def _up_hypotheses(poses: Poses, rng: np.random.Generator) -> np.ndarray:
    """Candidate verticals: cross products of two photos' axes, and the axes, both signs."""
    right_axes, up_axes = photographer_axes(poses)
    n = len(right_axes)
    first, second = rng.integers(n, size=_N_PAIRS), rng.integers(n, size=_N_PAIRS)
    turns = rng.integers(4, size=(2, _N_PAIRS))
    cross = np.cross(right_axes[first, turns[0]], right_axes[second, turns[1]])
    cross = cross[np.linalg.norm(cross, axis=1) > _PARALLEL]
    mean_up = up_axes[:, 0].mean(axis=0, keepdims=True)
    candidates = unit(np.concatenate([mean_up, up_axes.reshape(-1, 3), cross]))
    return np.concatenate([candidates, -candidates])


def _solve_vertical(
    right: np.ndarray, direction: ArrayLike
) -> tuple[np.ndarray, np.ndarray, float]:
    """One robust Gauss-Newton step for the direction orthogonal to the `right` axes."""
    basis = tangent_basis(direction)
    residuals = np.arcsin(np.clip(right @ direction, -1, 1))
    # The median of |roll| also feels a shared bias, which is then part of the uncertainty.
    spread = max(robust_sigma(residuals), np.radians(_LEAST_SPREAD_DEG))
    weights = 1.0 / (1.0 + (residuals / (_OUTLIER * spread)) ** 2) ** 2
    rows = right @ basis.T  # (N, 2)
    information = (rows * weights[:, None]).T @ rows
    # A photo series from one side leaves the tilt towards it open: the ridge keeps the start there.
    ridge = _RIDGE * len(right) * np.eye(2)
    step = np.linalg.solve(information + ridge, -(rows * weights[:, None]).T @ residuals)
    values, vectors = np.linalg.eigh(information)
    effective = max(weights.sum(), 1.0)
    inflate = spread**2 * (1.0 + _SMALL_SAMPLE / effective)
    variances = inflate / np.maximum(values, 1e-6) + np.radians(_UP_FLOOR_DEG) ** 2
    axes = vectors.T @ basis
    covariance = np.einsum("k,ki,kj->ij", variances, axes, axes)
    return unit(direction + step @ basis), covariance, float(np.degrees(spread))
