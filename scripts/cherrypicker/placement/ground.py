"""Ground of an outdoor scan: candidate planes by RANSAC, and the surface's shape under the tree."""

import logging
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.geometry.directions import unit
from cherrypicker.geometry.ground_surface import robust_plane
from cherrypicker.geometry.sampling import thin_randomly, voxel_sample
from cherrypicker.placement.up import roll_costs
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)

# No scale is known: lengths are shares of the cameras' distance to what they look at
# Of RANSAC; half and twice as many move up by 0.001 degrees on nine scans
N_TRIES, TEST_POINTS = 1500, 3000
MOST_POINTS = 400_000  # of a cloud that are asked: bounds the time
# The ground's cells: width, how far around the target, and the fewest that make a plane; heights
# that may be ground. Half and twice as much move three scans by 5 mm and 0.06 degrees at most, but
# for twice the heights, which put the ground of one 0.5 m too low
CELL, REACH, FEWEST_CELLS, TOLERANCE = 0.1, 2.5, 12, 0.3
SPOT_CELL, N_SPOT = 0.024, 80  # below a spot: 7 cm wide seen from 3 m, a stem fills few
LOW_QUANTILE = 0.1  # of the heights in a cell; low, since what is not ground stands on it
LOWEST_PERCENTILE = 1  # of heights that stands for the lowest: what is below is noise
# Planes that are tried, one after the other; 1 and 10 find the same ground on four scans
N_PLANES = 5
# Share of the photos that speak for the ground, or it is none; 0.25 and 0.75 find it on nine scans
MIN_SCORE = 0.5


@dataclass(frozen=True)
class AlignOptions:
    """How ground and vertical are found; the fields are the config keys of ``align``."""

    ground_distance_fraction: float = 0.03
    plane: str = "judged"
    up_from: str = "auto"
    flip: str = "cameras"


@dataclass
class Plane:
    """Plane ``normal . x + offset = 0`` with the evidence for its being the ground."""

    normal: np.ndarray  # (3,): unit normal, on the side of most cameras
    offset: float
    n_inliers: int  # points within the inlier distance
    score: float  # in [0, 1]: share of the photos that speak for it
    allowed: float  # and of those that speak for it or frame nothing beneath their way to the tree
    factors: dict  # means over the photos of ``upright``, ``above`` and ``beneath``

    def height(self, points: np.ndarray) -> np.ndarray:
        """Signed distance of points above the plane, shape (n_points,)."""
        return points @ self.normal + self.offset


def find_ground(
    points: np.ndarray,
    poses: Poses,
    target: np.ndarray,
    distance: float,
    options: AlignOptions,
    *,
    stated_turns: np.ndarray | None = None,
    seed: int = 0,
) -> tuple[Plane | None, list[Plane]]:
    """Find the plane of the ground among points (n_points, 3) near what the cameras look at.

    A photo speaks for a plane where its camera is above it, is held upright over it, and has some
    of the plane's points beneath the way to the tree. A wall, a roof or a hedge fails. Where photos
    speak for none, the largest is taken that they allow: what no photo frames is no word against
    it. Target (3,) and distance are as of
    :func:`cherrypicker.placement.region.look_at_point`, the quarter turns of the stored photos,
    (n_cameras,) int, as of EXIF.

    Returns the ground, None where the photos allow no plane, and the candidates, each the largest
    of what the ones before it left, that with the best score first. Where ``options.plane`` is
    "ransac" the largest of all points decides by itself, as the paper has it.
    """
    is_alone = options.plane == "ransac"
    threshold = options.ground_distance_fraction * distance
    rest, find = points, _papers_plane
    if not is_alone:
        find = _largest_plane
        near = points[np.linalg.norm(points - target, axis=1) < REACH * distance]
        rest, *_ = voxel_sample(near if len(near) else points, threshold)
    ways, planes = (poses.centers + target) / 2, list[Plane]()
    while len(planes) < (1 if is_alone else N_PLANES) and len(rest) > 2:
        normal, offset = find(rest, threshold, seed)
        if np.median(poses.centers @ normal) < -offset:
            normal, offset = -normal, -offset
        is_inlier = np.abs(rest @ normal + offset) < threshold
        feet = ways - (ways @ normal + offset)[:, None] * normal
        said = {
            "upright": 1.0 - roll_costs(poses, normal, stated_turns)[0],
            "above": poses.centers @ normal + offset > 0,
            "beneath": cKDTree(rest[is_inlier]).query(feet)[0] < 2 * CELL * distance,
        }
        is_upright, is_open = said["upright"] * said["above"], ~poses.frames(feet).any(axis=0)
        score = float(np.mean(is_upright * said["beneath"]))
        allowed = float(np.mean(is_upright * (said["beneath"] | is_open)))
        factors = {name: float(value.mean()) for name, value in said.items()}
        planes.append(Plane(normal, offset, int(is_inlier.sum()), score, allowed, factors))
        logger.info(
            f"plane of {is_inlier.sum()} points: score {score:.3f}, allowed {allowed:.3f} {factors}"
        )
        rest = rest[~is_inlier]
    ground = max(planes, key=attrgetter("score"), default=None)
    if ground and not is_alone and ground.score < MIN_SCORE:
        ground = next((plane for plane in planes if plane.allowed >= MIN_SCORE), None)
    planes.sort(key=attrgetter("score"), reverse=True)
    return ground, planes


def _papers_plane(points: np.ndarray, distance: float, seed: int) -> tuple[np.ndarray, float]:
    """As `_largest_plane` by Open3D, as in the paper; it needs libraries that pip cannot bring."""
    import open3d

    open3d.utility.random.seed(seed)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    # Any other probability ends the search early, after how many tries the threads decide
    plane, _ = cloud.segment_plane(distance, 3, N_TRIES, probability=1.0)
    *normal, offset = plane / np.linalg.norm(plane[:3])
    return np.array(normal), offset


def _largest_plane(points: np.ndarray, distance: float, seed: int) -> tuple[np.ndarray, float]:
    """Unit normal and offset of the plane with the most points within a distance, by RANSAC.

    The best of planes through three points each, refitted to its inliers by least squares.
    """
    rng = np.random.default_rng(seed)
    first, second, third = points[rng.integers(len(points), size=(3, N_TRIES))]
    across = np.cross(second - first, third - first)
    normals = unit(across)
    off = thin_randomly(points, TEST_POINTS, seed) @ normals.T - np.sum(first * normals, axis=1)
    counts = (np.abs(off) < distance).sum(axis=0)
    best = np.argmax(counts * (np.linalg.norm(across, axis=1) > distance**2))
    inliers = points[np.abs((points - first[best]) @ normals[best]) < distance]
    center = inliers.mean(axis=0)
    normal = np.linalg.eigh(np.cov(inliers - center, rowvar=False, bias=True))[1][:, 0]
    return normal, float(-normal @ center)


def ground_cells(points: np.ndarray, distance: float, width: float = CELL) -> np.ndarray:
    """Low points of the cells of a grid around the z axis: the ground where it was seen.

    Points (n_points, 3) have z up and the ground near z = 0. The width of a cell is a share of the
    cameras' median distance to what they look at. Mean x, y and a low quantile of z of each cell,
    (n_cells, 3).
    """
    cell, reach = width * distance, REACH * distance
    near = np.hypot(points[:, 0], points[:, 1]) < reach
    points = points[near & (np.abs(points[:, 2]) < TOLERANCE * distance)]
    column, row = np.floor((points[:, :2] + reach) / cell).astype(np.int64).T
    number = column * int(2 * reach / cell + 1) + row
    order = np.lexsort((points[:, 2], number))
    points = points[order]
    _, starts, counts = np.unique(number[order], return_index=True, return_counts=True)
    low = points[starts + (LOW_QUANTILE * (counts - 1)).astype(int), 2]
    middle = np.add.reduceat(points[:, :2], starts, axis=0) / counts[:, None]
    return np.column_stack([middle, low])


def ground_plane(
    points: np.ndarray, distance: float, width: float = CELL, n_nearest: int | None = None
) -> np.ndarray | None:
    """The ground's shape around the z axis: a robust plane ``z = a + b x + c y`` through its cells.

    a, b, c, (3,); None where too little of the ground was seen. Of the cells, as `ground_cells`
    finds them, so many count as are nearest to the axis, or all. They have equal area, so that far
    ground counts as much as what many photos show. Of as many around the axis half have to be seen:
    what little is seen there may be a crown's.
    """
    cells = ground_cells(points, distance, width)
    if len(cells) < FEWEST_CELLS:
        return None
    away = np.hypot(cells[:, 0], cells[:, 1])
    if n_nearest is not None:
        n_around = np.count_nonzero(away <= width * distance * np.sqrt(n_nearest / np.pi))
        if 2 * n_around < n_nearest:
            return None
    cells = cells[np.argsort(away, kind="stable")[:n_nearest]]
    return robust_plane(cells[:, :2], cells[:, 2])
