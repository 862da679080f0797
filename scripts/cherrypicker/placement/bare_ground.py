"""Fewer points of what is no tree: bare ground, and what lies beyond the region of interest.

Four fifths of a cloud are grass, soil and hills, a point every few millimetres, which every later
stage reads, moves and writes. Where nothing stands on it, one point a small voxel tells as much.
"""

from __future__ import annotations

import logging

import numpy as np
from scipy.ndimage import binary_dilation, map_coordinates

from cherrypicker.geometry.ground_surface import GroundSurface
from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.placement.directions import rodrigues
from cherrypicker.placement.ground import (
    LOW_QUANTILE,
    MOST_POINTS,
    REACH,
    SPOT_CELL,
    TOLERANCE,
    AlignOptions,
    Plane,
    find_ground,
    ground_cells,
)
from cherrypicker.placement.region import Region
from cherrypicker.poses import Poses

__all__ = ["needed_points"]

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
    margin_fraction : float or None, default 0
        As of the crop, which takes what lies beyond the region; None where its box may keep that.
    seed : int

    Returns
    -------
    ndarray of shape (n_points,), bool
        All true where the points show no plane that the cameras stand on.
    """
    distance, options = region.distance, AlignOptions()  # the ground is found as it will be there
    sample = thin_randomly(points, MOST_POINTS, seed)
    plane, _ = find_ground(sample, poses, region.center, distance, options, seed=seed)
    if plane is None:
        logger.warning("no ground that the cameras stand on: all points are kept")
        return np.ones(len(points), bool)
    ground = _Ground(plane, sample, region)
    band = options.ground_distance_fraction * distance
    reach = np.inf if margin_fraction is None else region.radius * (1.0 + 2.0 * margin_fraction)
    # In blocks, which bounds the memory: where something stands, then what does not
    blocks = np.split(points, range(MOST_POINTS, len(points), MOST_POINTS))
    n_low, n_all = np.zeros((2, ground.n**2), np.int64)
    for block in blocks:
        _, cell, height = ground.place(block)
        n_all += np.bincount(cell[height <= TOLERANCE * distance], minlength=ground.n**2)
        is_low = (height > band) & (height <= TOLERANCE * distance)
        n_low += np.bincount(cell[is_low], minlength=ground.n**2)
    stands = (n_low > LOW_QUANTILE * n_all).reshape(ground.n, ground.n)  # fewer are grass
    around = binary_dilation(stands, np.ones((3, 3), bool)).ravel()
    is_spare, voxel = [], []
    for block in blocks:
        away, cell, height = ground.place(block)
        is_spare.append((away > reach) | ((height <= band) & ~around[cell]))
        voxel.append(_voxels((block - region.center) / distance, spacing))
    spare = np.flatnonzero(np.concatenate(is_spare))
    _, first = np.unique(np.concatenate(voxel)[spare], return_index=True)
    keep = np.ones(len(points), bool)
    keep[spare] = False
    keep[spare[first]] = True
    logger.info(
        "of %s of %s points, bare ground and what lies beyond the region, %s are kept",
        f"{len(spare):,}",
        f"{len(points):,}",
        f"{len(first):,}",
    )
    return keep


class _Ground:
    """The ground's surface in square cells around the middle of the region."""

    def __init__(self, plane: Plane, sample: np.ndarray, region: Region) -> None:
        self.rotation = rodrigues(plane.normal, [0.0, 0.0, 1.0])
        self.origin = region.center - plane.height(region.center) * plane.normal
        self.cell, self.n = SPOT_CELL * region.distance, 2 * int(REACH / SPOT_CELL) + 1
        at = self.cell * (np.arange(self.n) - self.n // 2)
        xy = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2)
        upright = (sample - self.origin) @ self.rotation.T
        surface = GroundSurface(ground_cells(upright, region.distance))
        self.heights = surface(xy).reshape(self.n, self.n)

    def place(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of each point its distance from the middle, its cell, and its height above or below the
        ground, NaN beyond the cells; each (n_points,)."""
        upright = (points - self.origin) @ self.rotation.T
        place = upright[:, :2].T / self.cell + self.n // 2
        height = np.abs(upright[:, 2] - map_coordinates(self.heights, place, order=1, cval=np.nan))
        x, y = np.where(np.isnan(height), 0, np.round(place)).astype(int)
        return np.hypot(*upright[:, :2].T), x * self.n + y, height


def _voxels(offset: np.ndarray, spacing: float) -> np.ndarray:
    """Number of the voxel of each place (n, 3) in the unit ball, (n,) int64."""
    # What is beyond goes onto the sphere: one in each direction
    offset = offset / np.maximum(np.linalg.norm(offset, axis=1), 1.0)[:, None]
    n_across = int(2 / spacing) + 1
    x, y, z = ((offset + 1.0) / spacing).astype(np.int64).T
    return (x * n_across + y) * n_across + z
