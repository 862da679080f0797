"""Fewer points of what is no tree: bare ground, and what lies beyond the region of interest.

Four fifths of a cloud are grass, soil and hills, a point every few millimetres, which every later
stage reads, moves and writes. Where nothing stands on it, one point a small voxel tells as much.
"""

import logging

import numpy as np
from scipy.ndimage import binary_dilation, map_coordinates

from cherrypicker.geometry.directions import rodrigues
from cherrypicker.geometry.ground_surface import ground_height
from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.placement.ground import (
    LOW_QUANTILE,
    MOST_POINTS,
    REACH,
    SPOT_CELL,
    TOLERANCE,
    AlignOptions,
    find_ground,
    ground_cells,
)
from cherrypicker.placement.region import Region
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)


def needed_points(
    points: np.ndarray,
    poses: Poses,
    region: Region,
    spacing: float,
    *,
    margin_fraction: float | None = 0.0,
    seed: int = 0,
) -> np.ndarray:
    """Which points to keep: all of the tree and of things, of all else one a voxel, (n_points,).

    All are where the points (n_points, 3), in the cameras' frame, show no plane that the cameras
    stand on. The spacing is a voxel's width as a share of the cameras' distance to the region's
    middle; beyond the region that of a voxel of its surface, through which a point is seen from the
    middle. The margin is that of the crop, which takes what lies beyond the region; None where its
    box may keep that.
    """
    distance, options = region.distance, AlignOptions()  # the ground is found as it will be there
    sample = thin_randomly(points, MOST_POINTS, seed)
    plane, _ = find_ground(sample, poses, region.center, distance, options, seed=seed)
    if plane is None:
        logger.warning("no ground that the cameras stand on: all points are kept")
        return np.ones(len(points), bool)
    rotation = rodrigues(plane.normal)
    origin = region.center - plane.height(region.center) * plane.normal
    seen = ground_cells((sample - origin) @ rotation.T, distance)
    n_cells = 2 * int(REACH / SPOT_CELL) + 1  # each way
    width, middle = SPOT_CELL * distance, n_cells // 2
    xy = width * (np.indices((n_cells, n_cells)).reshape(2, -1).T - middle)
    ground, parts = ground_height(xy, seen, 0.0, n_nearest=5).reshape(n_cells, n_cells), []
    for block in np.split(points, range(MOST_POINTS, len(points), MOST_POINTS)):  # bounds memory
        upright = (block - origin) @ rotation.T
        place = upright[:, :2].T / width + middle
        off = np.abs(upright[:, 2] - map_coordinates(ground, place, order=1, cval=np.nan))
        x, y = np.where(np.isnan(off), 0, np.round(place)).astype(int)
        parts.append((np.hypot(*upright[:, :2].T), x * n_cells + y, off))
    # From the region's middle; square of the ground; above or below it, NaN beyond the squares
    away, cell, height = (np.concatenate(part) for part in zip(*parts, strict=True))
    band = options.ground_distance_fraction * distance
    near = height <= TOLERANCE * distance
    n_all = np.bincount(cell[near], minlength=n_cells**2)
    n_low = np.bincount(cell[near & (height > band)], minlength=n_cells**2)
    stands = (n_low > LOW_QUANTILE * n_all).reshape(n_cells, n_cells)  # fewer are grass
    around = binary_dilation(stands, np.ones((3, 3), bool)).ravel()
    reach = np.inf if margin_fraction is None else region.radius * (1.0 + 2.0 * margin_fraction)
    spare = np.flatnonzero((away > reach) | ((height <= band) & ~around[cell]))
    offset = (points[spare] - region.center) / distance
    # What is beyond goes onto the sphere: one in each direction
    offset /= np.maximum(np.linalg.norm(offset, axis=1), 1.0)[:, None]
    n_across = int(2 / spacing) + 1
    x, y, z = ((offset + 1.0) / spacing).astype(np.int64).T
    _, first = np.unique((x * n_across + y) * n_across + z, return_index=True)
    keep = np.ones(len(points), bool)
    keep[spare] = False
    keep[spare[first]] = True
    logger.info(
        f"of {len(spare):,} of {len(points):,} points, bare ground and what lies beyond the "
        f"region, {len(first):,} are kept"
    )
    return keep
