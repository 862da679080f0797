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
from cherrypicker.placement.align import MIN_SCORE, AlignOptions
from cherrypicker.placement.directions import rodrigues
from cherrypicker.placement.ground import (
    LOW_QUANTILE,
    MOST_POINTS,
    REACH,
    SPOT_CELL,
    TOLERANCE,
    Plane,
    ground_cells,
    judged_planes,
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
    reach = np.inf if margin_fraction is None else region.radius * (1.0 + 2.0 * margin_fraction)
    ground = _Ground(planes[0], sample, region, band, reach)
    blocks = [slice(at, at + MOST_POINTS) for at in range(0, len(points), MOST_POINTS)]
    for block in blocks:
        ground.note(points[block])
    voxel = np.concatenate([ground.spare_voxels(points[block], spacing) for block in blocks])
    spare = np.flatnonzero(voxel >= 0)
    _, first = np.unique(voxel[spare], return_index=True)
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
    """The ground's surface in square cells, and in which of them something stands.

    Points are given in blocks, which bounds the memory.
    """

    def __init__(
        self, plane: Plane, sample: np.ndarray, region: Region, band: float, reach: float
    ) -> None:
        self.region, self.band, self.reach = region, band, reach
        self.rotation = rodrigues(plane.normal, [0.0, 0.0, 1.0])
        self.origin = region.center - plane.height(region.center[None])[0] * plane.normal
        self.cell, self.n = SPOT_CELL * region.distance, 2 * int(REACH / SPOT_CELL) + 1
        at = self.cell * (np.arange(self.n) - self.n // 2)
        xy = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2)
        surface = GroundSurface(ground_cells(self._upright(sample), region.distance))
        self.heights = surface(xy).reshape(self.n, self.n)
        self.n_low, self.n_all = np.zeros((2, self.n * self.n), np.int64)

    def _upright(self, points: np.ndarray) -> np.ndarray:
        return (points - self.origin) @ self.rotation.T

    def _placed(self, upright: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cell of each point (n,), and its height over the ground, NaN beyond the cells."""
        place = upright[:, :2].T / self.cell + self.n // 2
        height = upright[:, 2] - map_coordinates(self.heights, place, order=1, cval=np.nan)
        cell = np.where(np.isnan(height), 0, np.round(place)).astype(int)
        return cell[0] * self.n + cell[1], height

    def note(self, points: np.ndarray) -> None:
        """Count what lies on the ground and low over it."""
        cell, height = self._placed(self._upright(points))
        near = np.abs(height) <= TOLERANCE * self.region.distance
        low = near & (np.abs(height) > self.band)
        self.n_all += np.bincount(cell[near], minlength=self.n**2)
        self.n_low += np.bincount(cell[low], minlength=self.n**2)

    def spare_voxels(self, points: np.ndarray, spacing: float) -> np.ndarray:
        """Voxel of each point (n,) that is spare, -1 of the others: ground that nothing stands on
        or beside, and what the default crop takes."""
        upright = self._upright(points)
        cell, height = self._placed(upright)
        stands = (self.n_low > LOW_QUANTILE * self.n_all).reshape(self.n, self.n)  # fewer are grass
        around = binary_dilation(stands, np.ones((3, 3), bool)).ravel()
        is_spare = np.hypot(upright[:, 0], upright[:, 1]) > self.reach
        is_spare |= (np.abs(height) <= self.band) & ~around[cell]
        offset = (points - self.region.center) / self.region.distance
        # What is beyond goes onto the sphere: one in each direction
        offset /= np.maximum(np.linalg.norm(offset, axis=1), 1.0)[:, None]
        n_across = int(2 / spacing) + 1
        x, y, z = ((offset + 1.0) / spacing).astype(np.int64).T
        return np.where(is_spare, (x * n_across + y) * n_across + z, -1)
