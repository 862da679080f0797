"""Ground of an outdoor scan: candidate planes by RANSAC, and the surface's shape under the tree.

No scale is known here; every length is a fraction of the cameras' distance to the point they look
at.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.geometry.ground_surface import robust_plane
from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.placement.directions import angle_deg, unit
from cherrypicker.placement.up import roll_costs
from cherrypicker.poses import Poses

# Lengths without a unit are shares of the cameras' distance to what they look at; all are guesses
N_TRIES, TEST_POINTS = 1500, 5000  # of RANSAC
LEAST_REST = 0.01  # share of the points in which another plane is sought
GROUND_NEAR = 0.3  # of the middle of a camera's way to the target, as seen from above
# The ground's cells: width, and how far around the target; heights that may be ground
CELL, REACH, TOLERANCE = 0.1, 2.5, 0.3
LOW_QUANTILE = 0.1  # of the heights in a cell; low, since what is not ground stands on it
FEWEST_IN_CELL, FEWEST_CELLS = 3, 12
# Cells below a spot, 7 cm wide seen from 3 m, and how many: a stem fills few of them
SPOT_CELL, SPOT_CELLS = 0.024, 80
LEVEL_DEG = 0.7  # what ground near a tree is off level at best
UNSEEN_DEG = 5.0  # what a level plane is off, where hardly any ground was seen


@dataclass
class Plane:
    """Plane ``normal . x + offset = 0`` with the evidence for its being the ground."""

    normal: np.ndarray  # (3,): unit normal, on the side of most cameras
    offset: float
    n_inliers: int  # points within the inlier distance
    score: float = 0.0  # in [0, 1]
    # Means over the photos of ``upright``, ``above`` and ``beneath``
    factors: dict = field(default_factory=dict)

    def height(self, points: np.ndarray) -> np.ndarray:
        """Signed distance of points above the plane, shape (n_points,)."""
        return points @ self.normal + self.offset


def plane_candidates(
    points: np.ndarray, distance: float, *, n_planes: int, seed: int = 0
) -> list[Plane]:
    """Find planes one after the other, each the largest of what the ones before it left.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3)
        Thinned cloud.
    distance : float
        Largest distance of an inlier from its plane.

    Returns
    -------
    list of Plane
        Fewer than `n_planes` when the points run out.
    """
    rest, planes = points, list[Plane]()
    while len(planes) < n_planes and len(rest) > max(3, LEAST_REST * len(points)):
        plane = largest_plane(thin_randomly(rest, TEST_POINTS, seed), distance, seed=seed)
        is_inlier = np.abs(plane.height(rest)) < distance
        plane.n_inliers = int(is_inlier.sum())
        planes.append(plane)
        rest = rest[~is_inlier]
    return planes


def largest_plane(points: np.ndarray, distance: float, *, seed: int = 0) -> Plane:
    """The plane with the most of the points (n_points, 3) within `distance`, by Open3D's RANSAC."""
    import open3d  # takes half a second

    open3d.utility.random.seed(seed)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    # Any other probability ends the search early, after how many tries the threads decide
    (*normal, offset), inliers = cloud.segment_plane(distance, 3, N_TRIES, probability=1.0)
    length = float(np.linalg.norm(normal))
    return Plane(np.array(normal) / length, offset / length, len(inliers))


def judge_plane(
    plane: Plane,
    points: np.ndarray,
    poses: Poses,
    *,
    target: np.ndarray,
    distance: float,
    inlier_distance: float,
    stated_turns: np.ndarray | None = None,
) -> None:
    """Rate how well a plane serves as the ground: by the photos that stand on it.

    A photo speaks for a plane where its camera is above it, is held upright over it, and has some
    of its points beneath the way to the tree. A wall, a roof or a hedge fails.

    Parameters
    ----------
    plane : Plane
        Gets its normal turned to the cameras' side, its factors and its score.
    points : ndarray of shape (n_points, 3)
        Thinned cloud.
    target : ndarray of shape (3,)
        Point that the cameras look at.
    distance : float
        Median distance of the cameras to the target.
    stated_turns : ndarray of shape (n_cameras,), int, optional
        Quarter turns of the stored photos according to EXIF.
    """
    centers = poses.centers
    if np.median(plane.height(centers)) < 0:
        plane.normal, plane.offset = -plane.normal, -plane.offset
    ways = (centers + target) / 2
    feet = ways - plane.height(ways)[:, None] * plane.normal
    inliers = points[np.abs(plane.height(points)) < inlier_distance]
    said = {
        "upright": 1.0 - roll_costs(poses, plane.normal, stated_turns)[0][0],
        "above": plane.height(centers) > 0,
        "beneath": cKDTree(inliers).query(feet)[0] < GROUND_NEAR * distance,
    }
    plane.factors = {name: float(value.mean()) for name, value in said.items()}
    plane.score = float(np.mean(said["upright"] * said["above"] * said["beneath"]))


def ground_cells(points: np.ndarray, cell: float, reach: float, tolerance: float) -> np.ndarray:
    """Low points of the cells of a grid around the z axis: the ground where it was seen.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3)
        Frame with z up, ground near z = 0.
    cell : float
        Width of a cell.
    reach : float
        Radius about the z axis.
    tolerance : float
        Points further than this from z = 0 are no ground.

    Returns
    -------
    ndarray of shape (n_cells, 3)
        Mean x, y and a low quantile of z of each cell.
    """
    near = (np.hypot(points[:, 0], points[:, 1]) < reach) & (np.abs(points[:, 2]) < tolerance)
    points = points[near]
    if len(points) == 0:
        return np.empty((0, 3))
    keys = np.floor((points[:, :2] + reach) / cell).astype(np.int64)
    flat = keys[:, 0] * (keys[:, 1].max() + 1) + keys[:, 1]
    order = np.lexsort((points[:, 2], flat))
    points, flat = points[order], flat[order]
    starts = np.flatnonzero(np.diff(flat, prepend=-1))
    counts = np.diff(starts, append=len(flat))
    low = points[starts + (LOW_QUANTILE * (counts - 1)).astype(int), 2]
    middle = np.add.reduceat(points[:, :2], starts, axis=0) / counts[:, None]
    return np.column_stack([middle, low])[counts >= FEWEST_IN_CELL]


def ground_tilt(points: np.ndarray, distance: float) -> tuple[np.ndarray, float, float | None]:
    """Normal of the ground around the z axis, and how far it may be trusted.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3)
        Cloud with z roughly up, the ground plane near z = 0 and the target on the z axis.
    distance : float
        Cameras' median distance to the target.

    Returns
    -------
    normal : ndarray of shape (3,)
        Of the far fit (radius 2.5 distances).
    sigma_deg : float
        One standard deviation of its tilt as a stand-in for the vertical, degrees.
    near_far_deg : float or None
        Angle between the fits within one and within 2.5 distances; None where too little was seen.
    """
    cells = ground_cells(points, CELL * distance, REACH * distance, TOLERANCE * distance)
    near = cells[np.hypot(cells[:, 0], cells[:, 1]) < distance]
    if len(cells) < FEWEST_CELLS:
        return np.array([0.0, 0.0, 1.0]), UNSEEN_DEG, None
    normal = _normal(cells)
    if len(near) < FEWEST_CELLS:
        return normal, UNSEEN_DEG, None
    # Hills give themselves away by the near and the far ground disagreeing.
    near_far = angle_deg(_normal(near), normal)
    return normal, LEVEL_DEG + near_far, near_far


def _normal(cells: np.ndarray) -> np.ndarray:
    """Unit normal, z positive, of the plane through cells of equal area: far ground counts."""
    (_, b, c), _ = robust_plane(cells[:, :2], cells[:, 2])
    return unit([-b, -c, 1.0])


def ground_height(points: np.ndarray, distance: float) -> float | None:
    """Height of the ground on the z axis, from what was seen around it; None where nothing was.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3)
        z up, ground near z = 0.
    distance : float
        Cameras' median distance to the target.
    """
    cells = ground_cells(points, SPOT_CELL * distance, distance, TOLERANCE * distance)
    if len(cells) < FEWEST_CELLS:
        return None
    nearest = np.argsort(np.hypot(cells[:, 0], cells[:, 1]), kind="stable")[:SPOT_CELLS]
    (level, _, _), _ = robust_plane(cells[nearest, :2], cells[nearest, 2])
    return float(level)
