"""Ground of an outdoor scan: candidate planes by RANSAC, and the surface's shape under the tree.

No scale is known here; every length is a fraction of the cameras' distance to the point they look
at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.geometry.robust import robust_sigma
from cherrypicker.placement.camera_geometry import angle_deg, roll_costs, unit
from cherrypicker.poses import Poses

# Lengths without a unit are shares of the cameras' distance to what they look at; all are guesses
# but where a source stands. RANSAC: of the points, and how many, a plane must still find
LEAST_REST = 0.01
FEWEST_REST = 30
N_ITERATIONS = 1500
TEST_POINTS = 3000
N_REFITS = 5
FEWEST_INLIERS = 10
# Factors of a plane's score: what would be perfect, or by what a fault of it weighs
INLIERS_WEIGHT = 5  # of the share of the points on the plane; a fifth of them is all that counts
UPRIGHT_POWER = 3
ABOVE_POWER = 8
LEAST_UPRIGHT, LEAST_ABOVE, LEAST_BENEATH = 1e-3, 0.1, 0.05
HEIGHTS = (0.1, 1.0)  # of the cameras over the ground: as high as they are far, or a tenth of it
HEIGHT_SCALE = 0.3
NEAR = 1.5  # points this near to the target must not lie below the plane
BELOW = 3  # inlier distances under the plane: below it
BELOW_SCALE = 0.2  # share of them
WAYS_IN = (0.0, 0.5, 0.9)  # from a camera to the target: ground lies beneath these places
GROUND_NEAR = 0.3  # this near
SEEN_SHARE = 0.5  # of the places; photos taken upwards see no ground at the camera's own feet
# The ground's cells
CELL, REACH = 0.1, 2.5  # width, and how far around the target
TOLERANCE, TOLERANCE_IN_INLIERS = 0.25, 6  # heights that may be ground
FEWEST_IN_CELL, FEWEST_CELLS = 3, 12
LOW_QUANTILE = 0.1  # of the heights in a cell; low, since what is not ground stands on it
MIDDLE_QUANTILE = 0.4  # of a cell under a spot: not pulled down by the noise
N_ROUNDS = 30
UNSEEN_DEG = 5.0  # what a level plane is off, where hardly any ground was seen
LEVEL_DEG = 0.7  # what ground near a tree is off level at best
HILL_SHARE = 0.5  # of the angle between the near ground and the far
# Cells on a radius of the ground below a spot: 7 cm wide seen from 3 m, more than a stem is thick
_CELLS_ACROSS = 5
WIDENINGS = (1.0, 2.0, 4.0)  # of the surroundings of a spot, until ground was seen
ROUGHNESS = 0.05  # of the reach: the scale of residuals of a spot's plane
# Rise from the middle to the edge of these cells that is still ground: 17 degrees (guess)
_STEEPEST = 0.3


@dataclass
class Plane:
    """Plane ``normal . x + offset = 0`` with the evidence for its being the ground."""

    normal: np.ndarray  # (3,): unit normal, on the side of most cameras
    offset: float
    n_inliers: int  # voxels of the thinned cloud within the inlier distance
    score: float = 0.0  # product of the factors, in [0, 1]
    # ``inliers``, ``cameras_up``, ``cameras_above``, ``height``, ``beneath``, ``nothing_below``
    factors: dict = field(default_factory=dict)

    def height(self, points: np.ndarray) -> np.ndarray:
        """Signed distance of points above the plane, shape (n_points,)."""
        return points @ self.normal + self.offset


def plane_candidates(
    points: np.ndarray,
    distance: float,
    *,
    n_planes: int,
    seed: int = 0,
) -> list[Plane]:
    """Find planes one after the other by RANSAC, each on what the ones before it left.

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
    rng = np.random.default_rng(seed)
    rest, planes = points, []
    for _ in range(n_planes):
        if len(rest) < max(FEWEST_REST, LEAST_REST * len(points)):
            break
        plane = _best_plane(rest, distance, rng)
        if plane is None:
            break
        planes.append(plane)
        rest = rest[np.abs(plane.height(rest)) > distance]
    return planes


def largest_plane(points: np.ndarray, distance: float, *, seed: int = 0) -> Plane:
    """The plane with the most of the points (n_points, 3) within `distance`, by Open3D's RANSAC."""
    import open3d  # takes seconds, and the default does without

    open3d.utility.random.seed(seed)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    # Any other probability ends the search early, after how many tries the threads decide
    (*normal, offset), inliers = cloud.segment_plane(distance, 3, N_ITERATIONS, probability=1.0)
    length = float(np.linalg.norm(normal))
    return Plane(np.array(normal) / length, offset / length, len(inliers))


def _best_plane(
    points: np.ndarray,
    distance: float,
    rng: np.random.Generator,
) -> Plane | None:
    """Plane with the most inliers, refitted to them."""
    triples = points[rng.integers(len(points), size=(N_ITERATIONS, 3))]  # (K, 3, 3)
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > distance**2
    if not usable.any():
        return None
    normals = normals[usable] / lengths[usable, None]
    offsets = -np.einsum("ki,ki->k", normals, triples[usable, 0])
    test = points[rng.permutation(len(points))[:TEST_POINTS]]
    counts = (np.abs(test @ normals.T + offsets) < distance).sum(axis=0)
    best = np.argmax(counts)
    normal, offset = normals[best], offsets[best]
    for _ in range(N_REFITS):
        inliers = np.abs(points @ normal + offset) < distance
        if inliers.sum() < FEWEST_INLIERS:
            return None
        normal, offset = _fit_plane(points[inliers], normal)
    return Plane(normal, offset, int((np.abs(points @ normal + offset) < distance).sum()))


def _fit_plane(points: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, float]:
    """Total least-squares plane, the normal's sign kept."""
    center = points.mean(axis=0)
    fitted = np.linalg.svd(points - center, full_matrices=False)[2][2]
    fitted = fitted * np.sign(fitted @ normal)
    return fitted, float(-fitted @ center)


def judge_plane(
    plane: Plane,
    points: np.ndarray,
    poses: Poses,
    *,
    target: np.ndarray,
    distance: float,
    inlier_distance: float,
    stated_turns: np.ndarray | None = None,
) -> Plane:
    """Rate how well a plane serves as the ground, by its inliers and by the camera poses.

    Ground lies beneath the cameras and beneath the way to the tree, all cameras stand on one side
    of it at a plausible height and hold their photos upright over it, and hardly anything lies
    below it. A wall or a hedge fails at several of these.

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
    heights = plane.height(centers)
    if np.median(heights) < 0:
        plane.normal, plane.offset, heights = -plane.normal, -plane.offset, -heights
    point_heights = plane.height(points)
    inliers = points[np.abs(point_heights) < inlier_distance]
    costs, _ = roll_costs(poses, plane.normal, stated_turns)
    relative = np.median(heights) / distance
    off_height = max(0.0, relative - HEIGHTS[1], HEIGHTS[0] - relative)
    near = np.linalg.norm(points - target, axis=1) < NEAR * distance
    below = (point_heights[near] < -BELOW * inlier_distance).mean() if near.any() else 1.0
    plane.factors = {
        "inliers": float(min(1.0, INLIERS_WEIGHT * len(inliers) / len(points))),
        "cameras_up": float(max(LEAST_UPRIGHT, 1 - costs.mean()) ** UPRIGHT_POWER),
        "cameras_above": float(max((heights > 0).mean(), LEAST_ABOVE) ** ABOVE_POWER),
        "height": float(np.exp(-((off_height / HEIGHT_SCALE) ** 2))),
        "beneath": LEAST_BENEATH
        + (1 - LEAST_BENEATH) * _share_beneath(plane, inliers, centers, target, distance),
        "nothing_below": float(np.exp(-((below / BELOW_SCALE) ** 2))),
    }
    plane.score = float(np.prod(list(plane.factors.values())))
    return plane


def _share_beneath(
    plane: Plane, inliers: np.ndarray, centers: np.ndarray, target: np.ndarray, distance: float
) -> float:
    """Share of the spots under the cameras, and half and nine tenths of the way in, with ground."""
    if len(inliers) == 0:
        return 0.0
    ways = np.concatenate([centers + f * (target - centers) for f in WAYS_IN])
    feet = ways - plane.height(ways)[:, None] * plane.normal
    nearest, _ = cKDTree(inliers).query(feet)
    return float(min(1.0, (nearest < GROUND_NEAR * distance).mean() / SEEN_SHARE))


def ground_cells(
    points: np.ndarray, cell: float, reach: float, tolerance: float, quantile: float = LOW_QUANTILE
) -> np.ndarray:
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
    quantile : float, default `LOW_QUANTILE`
        Of z in a cell.

    Returns
    -------
    ndarray of shape (n_cells, 3)
        Mean x, y and the quantile of z of each cell.
    """
    near = (np.hypot(points[:, 0], points[:, 1]) < reach) & (np.abs(points[:, 2]) < tolerance)
    points = points[near]
    if len(points) == 0:
        return np.empty((0, 3))
    keys = np.floor(points[:, :2] / cell).astype(np.int64)
    width = 2 * int(np.ceil(reach / cell)) + 4
    flat = (keys[:, 0] + width // 2) * width + keys[:, 1] + width // 2
    order = np.lexsort((points[:, 2], flat))
    points, flat = points[order], flat[order]
    starts = np.flatnonzero(np.diff(flat, prepend=-1))
    counts = np.diff(starts, append=len(flat))
    low = points[starts + (quantile * (counts - 1)).astype(int), 2]
    middle = np.add.reduceat(points[:, :2], starts, axis=0) / counts[:, None]
    cells = np.column_stack([middle, low])[counts >= FEWEST_IN_CELL]
    return cells


def fit_slope(cells: np.ndarray, scale: float) -> tuple[np.ndarray, float]:
    """Robust plane ``z = a + b x + c y`` through cells of equal area, so that far ground counts.

    Parameters
    ----------
    cells : ndarray of shape (n_cells, 3)
    scale : float
        Residual at which a cell's weight has fallen to a quarter.

    Returns
    -------
    coefficients : ndarray of shape (3,)
        a, b, c.
    residual : float
        Robust standard deviation of the residuals.
    """
    design = np.column_stack([np.ones(len(cells)), cells[:, :2]])
    weights = np.ones(len(cells))
    coefficients = np.zeros(3)
    for _ in range(N_ROUNDS):
        left = (design * weights[:, None]).T @ design + 1e-12 * len(cells) * np.eye(3)
        coefficients = np.linalg.solve(left, (design * weights[:, None]).T @ cells[:, 2])
        residuals = cells[:, 2] - design @ coefficients
        weights = 1.0 / (1.0 + (residuals / scale) ** 2) ** 2
    return coefficients, robust_sigma(residuals)


def slope_normal(coefficients: np.ndarray) -> np.ndarray:
    """Unit normal, z positive, of the plane ``z = a + b x + c y``."""
    return unit([-coefficients[1], -coefficients[2], 1.0])


def ground_tolerance(distance: float, inlier_distance: float) -> float:
    """Height above and below z = 0 that may still be ground."""
    return max(TOLERANCE_IN_INLIERS * inlier_distance, TOLERANCE * distance)


def ground_tilt(
    points: np.ndarray, distance: float, inlier_distance: float
) -> tuple[np.ndarray, float, float | None]:
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
    tolerance = ground_tolerance(distance, inlier_distance)
    cells = ground_cells(points, CELL * distance, REACH * distance, tolerance)
    if len(cells) < FEWEST_CELLS:
        return np.array([0.0, 0.0, 1.0]), UNSEEN_DEG, None
    coefficients, residual = fit_slope(cells, inlier_distance)
    normal = slope_normal(coefficients)
    radius = float(np.sqrt(np.mean(cells[:, 0] ** 2 + cells[:, 1] ** 2)))
    roughness = np.degrees(np.arctan2(residual, radius))
    near = cells[np.hypot(cells[:, 0], cells[:, 1]) < distance]
    near_far = None
    if len(near) >= FEWEST_CELLS:
        near_far = angle_deg(slope_normal(fit_slope(near, inlier_distance)[0]), normal)
    # Hills give themselves away by the near and the far ground disagreeing.
    sigma = float(np.hypot(LEVEL_DEG, roughness) + HILL_SHARE * (near_far or 0.0))
    return normal, sigma, near_far


def ground_height_at(
    points: np.ndarray, xy: Sequence[float], radius: float, tolerance: float
) -> float | None:
    """Height of the ground at a spot, from the seen ground around it.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3)
        z up.
    xy : array-like of shape (2,)
    radius : float
        How far the surroundings reach; widened up to four times where nothing was seen.
    tolerance : float
        Ground lies within this of z = 0.

    Returns
    -------
    float or None
        None where no ground was seen.
    """
    local = points - np.array([xy[0], xy[1], 0.0])
    for factor in WIDENINGS:
        reach = factor * radius
        # A stem fills few of the 80 cells; what stands out of the plane weighs next to nothing.
        cells = ground_cells(local, reach / _CELLS_ACROSS, reach, tolerance, MIDDLE_QUANTILE)
        if len(cells) >= FEWEST_CELLS:
            near = np.abs(cells[:, 2] - np.median(cells[:, 2])) < _STEEPEST * reach
            coefficients, _ = fit_slope(cells[near], ROUGHNESS * reach)
            return float(coefficients[0])
    return None
