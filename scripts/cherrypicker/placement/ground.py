"""Ground of an outdoor scan: candidate planes by RANSAC, and the surface's shape under the tree.

No scale is known here; every length is a fraction of the cameras' distance to the point they look
at.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.placement.camera_geometry import angle_deg, roll_costs, unit

# Cells on a radius of the ground below a spot: 7 cm wide seen from 3 m, more than a stem is thick
_CELLS_ACROSS = 5
# Rise from the middle to the edge of these cells that is still ground: 17 degrees (guess)
_STEEPEST = 0.3


@dataclass
class Plane:
    """Plane ``normal . x + offset = 0`` with the evidence for its being the ground.

    Attributes
    ----------
    normal : ndarray of shape (3,)
        Unit normal, on the side of most cameras.
    offset : float
    n_inliers : int
        Voxels of the thinned cloud within the inlier distance.
    score : float
        Product of the factors, in [0, 1].
    factors : dict of str to float
        ``inliers``, ``cameras_up``, ``cameras_above``, ``height``, ``beneath``, ``nothing_below``.
    """

    normal: np.ndarray
    offset: float
    n_inliers: int
    score: float = 0.0
    factors: dict | None = None

    def height(self, points):
        """Signed distance of points above the plane, shape (n_points,)."""
        return points @ self.normal + self.offset


def plane_candidates(points, distance, *, n_planes, n_iterations=1500, seed=0):
    """Find planes one after the other by RANSAC, each on what the ones before it left.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3)
        Thinned cloud.
    distance : float
        Largest distance of an inlier from its plane.
    n_planes : int
    n_iterations : int, default 1500
    seed : int, default 0

    Returns
    -------
    list of Plane
        Fewer than `n_planes` when the points run out.
    """
    rng = np.random.default_rng(seed)
    rest, planes = points, []
    for _ in range(n_planes):
        if len(rest) < max(30, 0.01 * len(points)):
            break
        plane = _best_plane(rest, distance, n_iterations, rng)
        if plane is None:
            break
        planes.append(plane)
        rest = rest[np.abs(plane.height(rest)) > distance]
    return planes


def _best_plane(points, distance, n_iterations, rng, n_test=3000):
    """Plane with the most inliers, refitted to them."""
    triples = points[rng.integers(len(points), size=(n_iterations, 3))]  # (K, 3, 3)
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > distance**2
    if not usable.any():
        return None
    normals = normals[usable] / lengths[usable, None]
    offsets = -np.einsum("ki,ki->k", normals, triples[usable, 0])
    test = points[rng.permutation(len(points))[:n_test]]
    counts = (np.abs(test @ normals.T + offsets) < distance).sum(axis=0)
    best = np.argmax(counts)
    normal, offset = normals[best], offsets[best]
    for _ in range(5):
        inliers = np.abs(points @ normal + offset) < distance
        if inliers.sum() < 10:
            return None
        normal, offset = _fit_plane(points[inliers], normal)
    return Plane(normal, offset, int((np.abs(points @ normal + offset) < distance).sum()))


def _fit_plane(points, normal):
    """Total least-squares plane, the normal's sign kept."""
    center = points.mean(axis=0)
    fitted = np.linalg.svd(points - center, full_matrices=False)[2][2]
    fitted = fitted * np.sign(fitted @ normal)
    return fitted, float(-fitted @ center)


def judge_plane(plane, points, poses, *, target, distance, inlier_distance, stated_turns=None):
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
    poses : Poses
    target : ndarray of shape (3,)
        Point that the cameras look at.
    distance : float
        Median distance of the cameras to the target.
    inlier_distance : float
    stated_turns : ndarray of shape (n_cameras,), int, optional
        Quarter turns of the stored photos according to EXIF.

    Returns
    -------
    Plane
    """
    centers = poses.centers
    heights = plane.height(centers)
    if np.median(heights) < 0:
        plane.normal, plane.offset, heights = -plane.normal, -plane.offset, -heights
    point_heights = plane.height(points)
    inliers = points[np.abs(point_heights) < inlier_distance]
    costs, _ = roll_costs(poses, plane.normal, stated_turns)
    relative = np.median(heights) / distance
    near = np.linalg.norm(points - target, axis=1) < 1.5 * distance
    below = (point_heights[near] < -3 * inlier_distance).mean() if near.any() else 1.0
    plane.factors = {
        "inliers": float(min(1.0, 5 * len(inliers) / len(points))),
        "cameras_up": float(max(1e-3, 1 - costs.mean()) ** 3),
        "cameras_above": float(max((heights > 0).mean(), 0.1) ** 8),
        "height": float(np.exp(-((max(0.0, relative - 1.0, 0.1 - relative) / 0.3) ** 2))),
        "beneath": 0.05 + 0.95 * _share_beneath(plane, inliers, centers, target, distance),
        "nothing_below": float(np.exp(-((below / 0.2) ** 2))),
    }
    plane.score = float(np.prod(list(plane.factors.values())))
    return plane


def _share_beneath(plane, inliers, centers, target, distance):
    """Share of the spots under the cameras, and half and nine tenths of the way in, with ground."""
    if len(inliers) == 0:
        return 0.0
    ways = np.concatenate([centers + f * (target - centers) for f in (0.0, 0.5, 0.9)])
    feet = ways - plane.height(ways)[:, None] * plane.normal
    nearest, _ = cKDTree(inliers).query(feet)
    # Photos taken upwards see no ground at the camera's own feet: half of the spots suffice.
    return float(min(1.0, 2 * (nearest < 0.3 * distance).mean()))


def ground_cells(points, cell, reach, tolerance, quantile=0.1):
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
    quantile : float, default 0.1
        Of z in a cell; low, since what is not ground stands on it.

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
    cells = np.column_stack([middle, low])[counts >= 3]
    return cells


def fit_slope(cells, scale):
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
    for _ in range(30):
        left = (design * weights[:, None]).T @ design + 1e-12 * len(cells) * np.eye(3)
        coefficients = np.linalg.solve(left, (design * weights[:, None]).T @ cells[:, 2])
        residuals = cells[:, 2] - design @ coefficients
        weights = 1.0 / (1.0 + (residuals / scale) ** 2) ** 2
    return coefficients, float(1.4826 * np.median(np.abs(residuals)))


def slope_normal(coefficients):
    """Unit normal, z positive, of the plane ``z = a + b x + c y``."""
    return unit([-coefficients[1], -coefficients[2], 1.0])


def ground_tilt(points, distance, inlier_distance):
    """Normal of the ground around the z axis, and how far it may be trusted.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3)
        Cloud with z roughly up, the ground plane near z = 0 and the target on the z axis.
    distance : float
        Cameras' median distance to the target.
    inlier_distance : float

    Returns
    -------
    normal : ndarray of shape (3,)
        Of the far fit (radius 2.5 distances).
    sigma_deg : float
        One standard deviation of its tilt as a stand-in for the vertical, degrees.
    near_far_deg : float or None
        Angle between the fits within one and within 2.5 distances; None where too little was seen.
    cells : ndarray of shape (n_cells, 3)
    """
    tolerance = max(6 * inlier_distance, 0.25 * distance)
    cells = ground_cells(points, 0.1 * distance, 2.5 * distance, tolerance)
    if len(cells) < 12:
        return np.array([0.0, 0.0, 1.0]), 5.0, None, cells
    coefficients, residual = fit_slope(cells, inlier_distance)
    normal = slope_normal(coefficients)
    radius = float(np.sqrt(np.mean(cells[:, 0] ** 2 + cells[:, 1] ** 2)))
    roughness = np.degrees(np.arctan2(residual, radius))
    near = cells[np.hypot(cells[:, 0], cells[:, 1]) < distance]
    near_far = None
    if len(near) >= 12:
        near_far = angle_deg(slope_normal(fit_slope(near, inlier_distance)[0]), normal)
    # Hills give themselves away by the near and the far ground disagreeing.
    sigma = float(np.hypot(0.7, roughness) + 0.5 * (near_far or 0.0))
    return normal, sigma, near_far, cells


def ground_height_at(points, xy, radius, tolerance):
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
    for factor in (1.0, 2.0, 4.0):
        reach = factor * radius
        # The middle of a cell is not pulled down by the noise. A stem fills few of the 80 cells;
        # what stands out of the plane weighs next to nothing.
        cells = ground_cells(local, reach / _CELLS_ACROSS, reach, tolerance, quantile=0.4)
        if len(cells) >= 12:
            near = np.abs(cells[:, 2] - np.median(cells[:, 2])) < _STEEPEST * reach
            coefficients, _ = fit_slope(cells[near], 0.05 * reach)
            return float(coefficients[0])
    return None
