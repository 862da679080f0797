"""White rings around stems, found by their brightness along the traced stem.

A calibration ring is two voxels of the network wide and as round as the stem, so that it passes
for wood. Seen along the stem it is plain: over a few centimetres all sides of the stem are white,
and bark below and above. Paint reaches the ground and lichen is on one side.
"""

from __future__ import annotations

import logging

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["ring_points"]

logger = logging.getLogger(__name__)

STEP_M = 0.01
N_SECTORS = 8
REACH_STEPS = 20  # bark this far below and above is what a step is compared with
MIN_CONTRAST = 1.22  # brightness against the same side's bark, median over the sides
SIDE_CONTRAST = 1.12  # and what a side must show
MIN_SIDES = 0.75  # share of the sides that must
SEEN_SIDES = 4  # sides with points, at least
WIDTH_STEPS = (2, 12)
BARK_STEPS = 4  # seen steps of bark below and above a ring
MAX_SATURATION = 0.3
MIN_POINTS = 4  # of a step's side
MAX_OFF = 0.012  # of a ring's points from the stem's surface, m


def _grid(along: np.ndarray, sector: np.ndarray, values: np.ndarray, n_steps: int) -> np.ndarray:
    """Median of values by step and side (n_steps, N_SECTORS), nan where few points lie."""
    cell = along * N_SECTORS + sector
    order = np.lexsort((values, cell))
    cell, values = cell[order], values[order]
    filled, first, count = np.unique(cell, return_index=True, return_counts=True)
    grid = np.full(n_steps * N_SECTORS, np.nan)
    enough = count >= MIN_POINTS
    grid[filled[enough]] = values[first[enough] + count[enough] // 2]
    return grid.reshape(n_steps, N_SECTORS)


def _bright_steps(grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which steps are brighter than the bark around them on all sides, and which are seen."""
    n_steps = len(grid)
    seen = np.isfinite(grid).sum(axis=1) >= SEEN_SIDES
    bright = np.zeros(n_steps, bool)
    for step in np.flatnonzero(seen):
        window = grid[max(0, step - REACH_STEPS) : step + REACH_STEPS + 1]
        known = np.isfinite(window).sum(axis=0) >= 2 * BARK_STEPS
        sides = np.flatnonzero(known & np.isfinite(grid[step]))
        if len(sides) < SEEN_SIDES:
            continue
        ratio = grid[step, sides] / np.maximum(np.nanmedian(window[:, sides], axis=0), 1e-3)
        enough = (ratio >= SIDE_CONTRAST).mean() >= MIN_SIDES
        bright[step] = enough and np.median(ratio) >= MIN_CONTRAST
    return bright, seen


def _runs(bright: np.ndarray, seen: np.ndarray) -> list[tuple[int, int]]:
    """(first, past) of runs of bright steps of a ring's width with bark below and above."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bright, [False]])))
    found = []
    for first, past in edges.reshape(-1, 2):
        if not WIDTH_STEPS[0] <= past - first <= WIDTH_STEPS[1]:
            continue
        bark = seen & ~bright
        below = bark[max(0, first - REACH_STEPS) : first].sum()
        above = bark[past : past + REACH_STEPS].sum()
        if min(below, above) >= BARK_STEPS:
            found.append((first, past))
    return found


def ring_points(
    points: np.ndarray, colors: np.ndarray, places: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """Points of white rings on a stem.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
        Wood of the stem, metres, z up.
    colors : ndarray of shape (n, 3), float
        In [0, 1].
    places : ndarray of shape (m, 3), float64
        The stem's axis from its foot up.
    radius : ndarray of shape (m,), float64

    Returns
    -------
    ndarray of shape (n,), bool
    """
    result = np.zeros(len(points), bool)
    if len(points) < 100 or len(places) < 2:
        return result
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    fine = np.arange(0.0, way[-1], STEP_M / 4)  # or a step would end where a node happens to lie
    places = np.stack([np.interp(fine, way, column) for column in places.T], axis=1)
    radius, way = np.interp(fine, way, radius), fine
    nearest = cKDTree(places).query(points, workers=1)[1]
    offset = points - places[nearest]
    off = np.linalg.norm(offset, axis=1) - radius[nearest]
    on = np.flatnonzero(np.abs(off) < MAX_OFF)
    if len(on) < 100:
        return result
    along = np.floor(way[nearest[on]] / STEP_M).astype(int)
    turn = np.arctan2(offset[on, 1], offset[on, 0]) / (2 * np.pi) + 0.5
    sector = np.minimum((turn * N_SECTORS).astype(int), N_SECTORS - 1)
    n_steps = int(along.max()) + 1
    bright, seen = _bright_steps(_grid(along, sector, colors[on].mean(axis=1), n_steps))
    for first, past in _runs(bright, seen):
        rows = on[(along >= first) & (along < past)]
        middle = np.median(colors[rows], axis=0)
        if np.ptp(middle) <= MAX_SATURATION * middle.max():
            result[rows] = True
            logger.info(
                "white ring on a stem, %.2f to %.2f m along it, %s points",
                first * STEP_M, past * STEP_M, f"{len(rows):,}",
            )  # fmt: skip
    return result
