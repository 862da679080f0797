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
from cherrypicker.geometry.stem_slabs import FEWEST_POINTS, stem_section

# Half and twice of each number (of the arc 100 and 300) find the same five of six sections on three
# scans, within half of their error; another slab also the sixth, at a fork and 3 % off: half the
# slab and a gap between things, m; a section's arc and scatter; rounds of scale and section
_HALF_HEIGHT_M, _GAP_M = 0.05, 0.015
_LEAST_ARC_DEG, _ROUGH = 200.0, 0.15
_N_ROUNDS = 12


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
        diameter = 2 * section.radius
        error = float(spread(trunk_terms(section)) / diameter)
        scale *= diameter_m / diameter
        if abs(diameter_m / diameter - 1) < error:
            return scale, error
    raise StageError(f"no scale makes a trunk of {diameter_m:g} m at {height_m:g} m")


def _stem_at(points: np.ndarray, height: float, seed: int) -> Section | None:
    """Section of the stem nearest to the middle at a height, across its own axis, all in metres."""
    slab = points[np.abs(points[:, 2] - height) <= _HALF_HEIGHT_M]
    thing = link_components(slab * [1.0, 1.0, 0.0], _GAP_M)
    names = np.flatnonzero(np.bincount(thing) >= FEWEST_POINTS)
    things = [slab[thing == name, :2] for name in names]
    for own in sorted(things, key=lambda own: float(np.linalg.norm(own.mean(axis=0)))):
        low, high = own.min(axis=0), own.max(axis=0)
        reach = (high - low).max()
        center, axis = np.append((low + high) / 2, height), np.array([0.0, 0.0, 1.0])
        rng = np.random.default_rng(seed)
        try:
            for _ in range(2):
                cut = center, axis, _HALF_HEIGHT_M, reach
                section, frame = stem_section(points, cut, 0.05 * reach, (0.0, reach), rng)
                center = center + section.parameters[:2] @ frame[:2]
                axis = unit(np.append(section.parameters[3:5], 1.0) @ frame)
        except StageError:
            continue
        if section.arc_deg >= _LEAST_ARC_DEG and section.noise <= _ROUGH * section.radius:
            return section
    return None
