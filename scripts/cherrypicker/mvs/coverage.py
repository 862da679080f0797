"""What the photos show of the region of interest, and what the depth maps hold of it, in voxels.

A voxel is wood by the photos where none that frames it shows clear sky all over it, and at least
four show something thin before the sky. Where no depth map holds anything there, the cloud lacks
what the photos show; nothing else in the pipeline can tell, since a cloud that ends is no error.
"""

from __future__ import annotations

import logging
from collections.abc import Collection
from typing import Any, NamedTuple

import cv2
import numpy as np

from cherrypicker.mvs.backends.map_keys import GEOMETRIC
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.workspace import View, Workspace, view_of
from cherrypicker.placement.region import Region, frames
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)

# Voxels across the region: 16 cm where the cameras stand 3.2 m away (guess)
N_ACROSS = 40
# Photos are looked at by every so many pixels: a voxel is some forty wide
STEP_PX = 4
# A pixel shows something where less of it is sky: all but what rounding leaves
NOTHING_BUT_SKY = 0.999
# What is narrower than this share of a photo's longer side is thin: limbs and twigs, not hills
# (guess)
THIN_SHARE = 0.03
# Photos that must show something thin before the sky, and the share of those that frame a voxel
# that may show clear sky there all the same (masks are wrong at times; guess)
LEAST_THIN = 4
MOST_CLEAR = 0.05


class Shown(NamedTuple):
    """Counts of photos for each of some voxels, each ndarray of shape (n_voxels,), int."""

    framing: np.ndarray  # photos that frame the voxel
    # thin, clear: photos that show something thin before the sky in it; that show clear sky all
    # over it
    thin: np.ndarray
    clear: np.ndarray

    @property
    def is_wood(self) -> np.ndarray:
        """Whether the photos say that there is wood in a voxel, (n_voxels,) bool."""
        return (self.thin >= LEAST_THIN) & (self.clear <= MOST_CLEAR * self.framing)


def measure_coverage(
    workspace: Workspace, region: Region, names: Collection[str], masks: SkyMasks
) -> dict[str, Any]:
    """Count, for every voxel of the region, what photos and depth maps have there.

    Parameters
    ----------
    names : collection of str
        Photos with a depth map.

    Returns
    -------
    dict
        Content of ``dense/coverage.json``: the region, the side of its voxels and how many go
        across it, their places ``cells`` in the cube around it (z the fastest), and of each how
        many photos frame it, how many depth maps hold something there, and how many photos show
        something thin before the sky or clear sky; lengths in units of COLMAP's frame.
    """
    grid = Grid(region)
    shown = look_for_wood(workspace.poses, masks, grid.centers, grid.size)
    n_holding = np.zeros(len(grid.centers), dtype=int)
    for view in workspace.views:
        if view.name in names:
            depth = workspace.read_depth(view, GEOMETRIC)[::STEP_PX, ::STEP_PX]
            n_holding[grid.occupied(_points_of(view, depth))] += 1
    logger.info(
        "half of the region's %s voxels of %.3g are framed by %d photos or more, %.1f %% are held "
        "by a depth map",
        f"{len(n_holding):,}",
        grid.size,
        np.median(shown.framing),
        100.0 * (n_holding > 0).mean(),
    )
    return {
        "region": {"center": region.center, "radius": region.radius},
        "camera_distance": region.distance,
        "voxel_size": grid.size,
        "n_across": N_ACROSS,
        "cells": grid.cells,
        "n_framing": shown.framing,
        "n_holding": n_holding,
        "n_thin_before_sky": shown.thin,
        "n_clear_sky": shown.clear,
    }


def look_for_wood(poses: Poses, masks: SkyMasks, centers: np.ndarray, size: float) -> Shown:
    """Count the photos that frame voxels, show something thin before the sky, or clear sky.

    Parameters
    ----------
    masks : SkyMasks
        Of the same photos.
    centers : ndarray of shape (n_voxels, 3)
        Frame of the poses.
    """
    n_framing, n_thin, n_clear = (np.zeros(len(centers), dtype=int) for _ in range(3))
    for i in range(len(poses)):
        own = np.flatnonzero(frames(poses, i, centers, size))
        sky, hidden = masks.both(view_of(poses, i))
        own = own[~_covers(hidden, poses, i, centers[own], size)]
        thin, clear = _before_sky(poses, i, centers[own], size, sky)
        n_framing[own] += 1
        n_thin[own] += thin
        n_clear[own] += clear
    return Shown(n_framing, n_thin, n_clear)


class Grid:
    """Cubic voxels in a region's ball: their ``cells`` in the cube around it, (n,) int, their
    middles ``centers``, (n, 3), and their side ``size``."""

    def __init__(self, region: Region):
        self.size = 2.0 * region.radius / N_ACROSS
        self._low = region.center - region.radius
        inside = region.holds(voxel_centers(region, np.arange(N_ACROSS**3)))
        self.cells = np.flatnonzero(inside)
        self.centers = voxel_centers(region, self.cells)
        self._row = np.full(N_ACROSS**3, -1)
        self._row[self.cells] = np.arange(len(self.cells))

    def occupied(self, points: np.ndarray) -> np.ndarray:
        """Rows of the voxels that hold any of the points (n, 3)."""
        cells = np.floor((points - self._low) / self.size).astype(int)
        cells = cells[((cells >= 0) & (cells < N_ACROSS)).all(axis=1)]
        rows = self._row[np.unique(cells @ [N_ACROSS**2, N_ACROSS, 1])]
        return rows[rows >= 0]


def voxel_centers(region: Region, cells: np.ndarray, n_across: int = N_ACROSS) -> np.ndarray:
    """Middles (n, 3) of the voxels at some places of the cube around a region."""
    place = np.stack(np.unravel_index(cells, (n_across,) * 3), axis=1)
    return region.center + region.radius * ((2.0 * place + 1.0) / n_across - 1.0)


def _points_of(view: View, depth: np.ndarray) -> np.ndarray:
    """World points (n, 3) of a depth map of every ``STEP_PX``-th pixel."""
    y, x = np.nonzero(depth > 0.0)
    z = depth[y, x].astype(np.float64)
    u = (STEP_PX * x + 0.5 - view.K[0, 2]) / view.K[0, 0]
    v = (STEP_PX * y + 0.5 - view.K[1, 2]) / view.K[1, 1]
    return (np.stack([u * z, v * z, z], axis=1) - view.t) @ view.R


def _before_sky(
    poses: Poses, i: int, centers: np.ndarray, size: float, sky: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Whether a photo shows something thin before the sky at voxels, and nothing but sky.

    ``sky`` (height, width) bool, True = sky. Returns two bool arrays (n_voxels,).
    """
    smaller = (sky.shape[1] // STEP_PX, sky.shape[0] // STEP_PX)
    share = cv2.resize(sky.astype(np.float32), smaller, interpolation=cv2.INTER_AREA)
    solid = (share < NOTHING_BUT_SKY).astype(np.uint8)
    side = 2 * max(round(0.5 * THIN_SHARE * max(solid.shape)), 1) + 1
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    thin = cv2.morphologyEx(solid, cv2.MORPH_TOPHAT, window)
    uv, depth = poses.project(centers, i)
    x, y = (np.minimum(uv[:, k] / STEP_PX, solid.shape[1 - k] - 1).astype(int) for k in (0, 1))
    reach = 0.5 * np.sqrt(3.0) * size * poses.K[i, 0, 0] / depth / STEP_PX
    return _distance_to(thin)[y, x] <= reach, _distance_to(solid)[y, x] > reach


def _covers(
    hidden: np.ndarray, poses: Poses, i: int, centers: np.ndarray, size: float
) -> np.ndarray:
    """Whether what a user hides (height, width) of photo ``i`` touches voxels, (n_voxels,) bool."""
    if not hidden.any():
        return np.zeros(len(centers), bool)
    uv, depth = poses.project(centers, i)
    x, y = (np.clip(uv[:, k], 0, hidden.shape[1 - k] - 1).astype(int) for k in (0, 1))
    reach = 0.5 * np.sqrt(3.0) * size * poses.K[i, 0, 0] / depth
    return _distance_to(hidden.astype(np.uint8))[y, x] <= reach


def _distance_to(mask: np.ndarray) -> np.ndarray:
    """Distance of each pixel to the nearest of a mask, px; infinite where it is empty."""
    if not mask.any():
        return np.full(mask.shape, np.inf)
    return cv2.distanceTransform(1 - mask, cv2.DIST_L2, 3)
