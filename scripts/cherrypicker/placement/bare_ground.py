"""Fewer points of what is no tree: bare ground, and what lies beyond the region of interest.

Four fifths of a cloud are grass, soil and hills, a point every few millimetres, which every later
stage reads, moves and writes. Where nothing stands on it, one point a small voxel tells as much.
"""

from __future__ import annotations

import logging

import numpy as np
from scipy.ndimage import binary_dilation, map_coordinates

from cherrypicker.geometry.ground_surface import GroundSurface
from cherrypicker.geometry.sampling import thin_randomly, voxel_keys
from cherrypicker.placement.align import MIN_SCORE, AlignOptions
from cherrypicker.placement.directions import rodrigues
from cherrypicker.placement.ground import (
    CELL,
    LOW_QUANTILE,
    MOST_POINTS,
    REACH,
    TOLERANCE,
    ground_cells,
    judged_planes,
)
from cherrypicker.placement.region import Region
from cherrypicker.poses import Poses

__all__ = ["needed_points"]

logger = logging.getLogger(__name__)


def needed_points(
    points: np.ndarray, poses: Poses, region: Region, spacing: float, *, seed: int = 0
) -> np.ndarray:
    """Which points to keep: all of the tree and of things, of all else one a voxel.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        In the cameras' frame.
    poses : Poses
    region : cherrypicker.placement.region.Region
        Of interest.
    spacing : float
        Width of a voxel in the cameras' distance to the region's middle; beyond the region that of
        a voxel of its surface, through which a point is seen from the middle.
    seed : int

    Returns
    -------
    ndarray of shape (n_points,), bool
        All true where the points show no plane that the cameras stand on.
    """
    keep = np.ones(len(points), bool)
    distance, options = region.distance, AlignOptions()  # the ground is found as it will be there
    band = options.ground_distance_fraction * distance
    sample = thin_randomly(points, MOST_POINTS, seed)
    planes = judged_planes(
        sample, poses, region.center, distance, band, n_planes=options.n_planes, seed=seed
    )
    if not planes or planes[0].score < MIN_SCORE:
        logger.warning("no ground that the cameras stand on: all points are kept")
        return keep
    rotation = rodrigues(planes[0].normal, [0.0, 0.0, 1.0])
    origin = region.center - planes[0].height(region.center[None])[0] * planes[0].normal
    upright = (points - origin) @ rotation.T
    surface = GroundSurface(ground_cells((sample - origin) @ rotation.T, distance))
    is_beyond = np.hypot(upright[:, 0], upright[:, 1]) > region.radius  # as the default crop
    spare = np.flatnonzero(is_beyond | _is_bare(upright, surface, distance, band))
    offset = points[spare] - region.center
    away = np.maximum(np.linalg.norm(offset, axis=1) / distance, 1.0)
    near = offset / away[:, None]  # what is beyond goes onto the sphere: one in each direction
    _, first = np.unique(voxel_keys(near, spacing * distance), return_index=True)
    keep[spare] = False
    keep[spare[first]] = True
    logger.info(
        "of %s of %s points, bare ground and what lies beyond the region, %s are kept",
        f"{len(spare):,}",
        f"{len(points):,}",
        f"{len(first):,}",
    )
    return keep


def _is_bare(
    points: np.ndarray, surface: GroundSurface, distance: float, band: float
) -> np.ndarray:
    """Which points (n, 3), z up from the ground, are ground that nothing stands on, or beside."""
    cell = CELL * distance
    n = 2 * int(REACH / CELL) + 1
    at = cell * (np.arange(n) - n // 2)
    xy = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2)
    heights = surface(xy).reshape(n, n)
    place = points[:, :2].T / cell + n // 2
    height = points[:, 2] - map_coordinates(heights, place, order=1, cval=np.nan)
    is_ground = np.abs(height) <= band
    is_low = ~is_ground & (np.abs(height) <= TOLERANCE * distance)
    node = np.where(is_ground | is_low, np.round(place), 0).astype(int)
    flat = node[0] * n + node[1]
    low, all_ = (np.bincount(flat[rows], minlength=n * n) for rows in (is_low, is_low | is_ground))
    stands = (low > LOW_QUANTILE * all_).reshape(n, n)  # fewer are blades of grass
    around = binary_dilation(stands, np.ones((3, 3), bool)).ravel()
    return is_ground & ~around[flat]
