"""The scale by a trunk's diameter that somebody taped at a height over the ground.

The stem is looked for in the denoised cloud, upright with the ground at z = 0 but without a scale
and without labels: of what stands at that height as a round section seen from most sides, it is the
one nearest to the middle of what the cameras look at. The height is in metres, so scale and section
are found in turns.
"""

from __future__ import annotations

import logging

import numpy as np
from scipy import ndimage

from cherrypicker.errors import StageError
from cherrypicker.geometry.error_terms import spread, trunk_terms
from cherrypicker.geometry.sections import Section
from cherrypicker.geometry.stem_slabs import stem_section

logger = logging.getLogger(__name__)

# Guesses, m where a unit is named: half the slab, a cell that joins points to things, what a stem
# may measure; of its section the arc, scatter and lean; rounds of scale and section, and their end
_HALF_HEIGHT_M, _CELL_M, _RADII_M = 0.05, 0.015, (0.008, 0.5)
_LEAST_ARC_DEG, _ROUGH, _LEAST_UPRIGHT = 200.0, 0.15, 0.7
_N_ROUNDS, _SETTLED = 12, 1e-4
_LEAST_POINTS = 60


def scale_of_trunk(
    points: np.ndarray, height_m: float, diameter_m: float, start: float, *, seed: int
) -> tuple[float, float]:
    """Scale by the diameter of the trunk.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
        Cloud, z up, ground at z = 0, x and y from what the cameras look at.
    height_m, diameter_m : float
        Of the tape over the ground, and what it measured over pi.
    start : float
        First guess of the scale, metres a unit.
    seed : int

    Returns
    -------
    scale, error : float
        Metres a unit, and its relative standard error without the tape's.

    Raises
    ------
    StageError
        If no stem stands at that height, or no scale makes height and diameter agree.
    """
    scale = start
    for _ in range(_N_ROUNDS):
        section = _stem_at(points, height_m, scale, np.random.default_rng(seed))
        before, scale = scale, diameter_m / (2 * section.radius)
        if abs(scale / before - 1) < _SETTLED:
            break
    else:
        raise StageError(f"no scale makes a trunk of {diameter_m:g} m at {height_m:g} m")
    return scale, float(spread(trunk_terms(section)) / (2 * section.radius))


def _stem_at(
    points: np.ndarray, height_m: float, scale: float, rng: np.random.Generator
) -> Section:
    """Section of the stem nearest to the middle at a height."""
    height, half = height_m / scale, _HALF_HEIGHT_M / scale
    slab = points[np.abs(points[:, 2] - height) <= half]
    best: tuple[float, Section] | None = None
    for thing in _things(slab, _CELL_M / scale):
        section = _round_section(slab[thing], points, height, half, scale, rng)
        if section is None:
            continue
        away = float(np.hypot(*slab[thing, :2].mean(axis=0)))
        if best is None or away < best[0]:
            best = away, section
    if best is None:
        raise StageError(
            f"no trunk stands {height_m:g} m over the ground: nothing round is seen from most "
            f"sides there, with {scale:.4g} metres a unit"
        )
    return best[1]


def _things(slab: np.ndarray, cell: float) -> list[np.ndarray]:
    """Rows of the points of each thing: of cells that touch, seen from above."""
    if len(slab) < _LEAST_POINTS:
        return []
    at = np.floor((slab[:, :2] - slab[:, :2].min(axis=0)) / cell).astype(int)
    grid = np.zeros(at.max(axis=0) + 1, bool)
    grid[at[:, 0], at[:, 1]] = True
    names = ndimage.label(grid, structure=np.ones((3, 3)))[0][at[:, 0], at[:, 1]]
    return [
        np.flatnonzero(names == name)
        for name in np.flatnonzero(np.bincount(names) >= _LEAST_POINTS)
    ]


def _round_section(
    thing: np.ndarray,
    points: np.ndarray,
    height: float,
    half: float,
    scale: float,
    rng: np.random.Generator,
) -> Section | None:
    """Section of a thing across its own axis; None for what is no stem."""
    center = np.append((thing[:, :2].min(axis=0) + thing[:, :2].max(axis=0)) / 2, height)
    reach = np.ptp(thing[:, :2], axis=0).max()
    low, high = _RADII_M
    if not 2 * low < scale * reach < 4 * high:
        return None
    axis, radii = np.array([0.0, 0.0, 1.0]), (low / scale, min(high / scale, reach))
    section = None
    for _ in range(2):
        slab = center, axis, half, reach
        try:
            section, frame = stem_section(points, slab, 0.05 * radii[1], radii, _LEAST_POINTS, rng)
        except StageError:
            return None
        center = center + section.parameters[:2] @ frame[:2]
        axis = np.append(section.parameters[3:5], 1.0) @ frame
        axis /= np.linalg.norm(axis)
    if section is None or axis[2] < _LEAST_UPRIGHT:
        return None
    is_round = section.arc_deg >= _LEAST_ARC_DEG and section.noise <= _ROUGH * section.radius
    return section if is_round and section.n_inliers >= 0.5 * len(thing) else None
