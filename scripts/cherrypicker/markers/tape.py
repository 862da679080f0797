"""The scale by a trunk's diameter that somebody taped at a height over the ground.

The stem is looked for in the denoised cloud, upright with the ground at z = 0 but without a scale
and without labels: of what stands at that height as a round section seen from most sides, it is the
one nearest to the middle of what the cameras look at. The height is in metres, so scale and section
are found in turns.
"""

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.geometry.directions import unit
from cherrypicker.geometry.error_terms import spread, trunk_terms
from cherrypicker.geometry.neighbors import link_components
from cherrypicker.geometry.sections import Section
from cherrypicker.geometry.stem_slabs import stem_section

# Guesses, m where a unit is named: half the slab, a gap between things, what a stem
# may measure; of its section the arc and scatter; rounds of scale and section, and their end
_HALF_HEIGHT_M, _GAP_M, _RADII_M = 0.05, 0.015, (0.008, 0.5)
_LEAST_ARC_DEG, _ROUGH = 200.0, 0.15
_N_ROUNDS, _SETTLED = 12, 1e-4
_LEAST_POINTS = 60


def scale_of_trunk(
    points: np.ndarray, height_m: float, diameter_m: float, start: float, *, seed: int
) -> tuple[float, float]:
    """Scale by a trunk's diameter, m a unit, and its relative standard error without the tape's.

    The points (n, 3) are a cloud's, z up, ground at z = 0, x and y from what the cameras look at.
    The height is that of the tape over the ground, the diameter what it measured over pi. ``start``
    is a first guess of the scale.

    Raises
    ------
    StageError
        If no stem stands at that height, or no scale makes height and diameter agree.
    """
    scale = start
    for _ in range(_N_ROUNDS):
        section = _stem_at(scale * points, height_m, seed)
        if section is None:
            raise StageError(
                f"no trunk stands {height_m:g} m over the ground: nothing round is seen from most "
                f"sides there, with {scale:.4g} metres a unit"
            )
        change = diameter_m / (2 * section.radius)
        scale *= change
        if abs(change - 1) < _SETTLED:
            return scale, float(spread(trunk_terms(section)) / (2 * section.radius))
    raise StageError(f"no scale makes a trunk of {diameter_m:g} m at {height_m:g} m")


def _stem_at(points: np.ndarray, height: float, seed: int) -> Section | None:
    """Section of the stem nearest to the middle at a height, across its own axis, all in metres."""
    slab = points[np.abs(points[:, 2] - height) <= _HALF_HEIGHT_M]
    thing = link_components(slab * [1.0, 1.0, 0.0], _GAP_M)
    names = np.flatnonzero(np.bincount(thing) >= _LEAST_POINTS)
    things = [slab[thing == name, :2] for name in names]
    thinnest, thickest = _RADII_M
    for own in sorted(things, key=lambda own: float(np.linalg.norm(own.mean(axis=0)))):
        low, high = own.min(axis=0), own.max(axis=0)
        reach = (high - low).max()
        if not 2 * thinnest < reach < 4 * thickest:
            continue
        center, axis = np.append((low + high) / 2, height), np.array([0.0, 0.0, 1.0])
        radii, rng = (thinnest, min(thickest, reach)), np.random.default_rng(seed)
        try:
            for _ in range(2):
                cut = center, axis, _HALF_HEIGHT_M, reach
                section, frame = stem_section(
                    points, cut, 0.05 * radii[1], radii, _LEAST_POINTS, rng
                )
                center = center + section.parameters[:2] @ frame[:2]
                axis = unit(np.append(section.parameters[3:5], 1.0) @ frame)
        except StageError:
            continue
        if section.arc_deg >= _LEAST_ARC_DEG and section.noise <= _ROUGH * section.radius:
            return section
    return None
