"""Diameters of the trunk at given heights, measured on the original points.

The skeleton only says where the stem is; radius and centre come from the labelled surface points
of a slab across the stem's local axis, so that a leaning stem is cut at right angles. Points of
other classes (calibration ring, post, sign) are left out; those that the network missed are
outliers of the robust fit.
"""

import logging
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.geometry.error_terms import Terms, trunk_terms
from cherrypicker.geometry.lines import Line
from cherrypicker.geometry.sections import FIRST_SCATTER
from cherrypicker.geometry.stem_slabs import FEWEST_POINTS, stem_section
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.foot import Foot

logger = logging.getLogger(__name__)

_LYING_DEG = 60.0
# Half the height of the stretch of stem whose points, and median radius, are those of a place;
# 0.05 and 0.15 m move the diameter at 0.30 m by 0.3 % at most on three scans
SPAN_M = 0.10
# Arc that points of a diameter cover; 60 and 240 degrees find the same eight on three scans
_LEAST_ARC_DEG = 120.0
_MOST_SHIFT_M = 0.2  # how far off a height it is measured where that fails there


@dataclass
class Stem:
    """The trunk's skeleton as a function of height."""

    points: np.ndarray  # (n, 3) float64: polyline from the foot to the trunk's end
    # radius, height: (n,) float64; the height is over the foot, along a stem that lies (it leans by
    # more than 60 degrees), and increases
    radius: np.ndarray
    height: np.ndarray

    @cached_property
    def line(self) -> Line:
        """The polyline by height."""
        return Line(self.points, self.height)

    @property
    def top(self) -> float:
        """Its end, the highest place at which it is measured."""
        return float(self.height[-1])

    def radius_around(self, height: float) -> float:
        """Median skeleton radius around a height."""
        away = np.abs(self.height - height)
        return float(np.median(self.radius[away <= max(SPAN_M, away.min())]))


def stem_of(skeleton: Skeleton, trunk_nodes: np.ndarray, foot: Foot) -> Stem:
    """Return the :class:`Stem` along the trunk's nodes (root first) over the foot."""
    points, radius = skeleton.points[trunk_nodes], skeleton.radius[trunk_nodes]
    along = Line(points).along
    is_lying = points[-1, 2] - points[0, 2] < np.cos(np.radians(_LYING_DEG)) * along[-1]
    height = along if is_lying else points[:, 2] - foot.point[2]
    # A noisy stem may dip; only nodes that rise above all before them define heights.
    rises = np.concatenate([[True], height[1:] > np.maximum.accumulate(height)[:-1]])
    points, radius, height = points[rises], radius[rises], height[rises]
    if not is_lying and height[0] > 0.01:
        points = np.vstack([[points[0, 0], points[0, 1], foot.point[2]], points])
        radius, height = np.concatenate([radius[:1], radius]), np.concatenate([[0.0], height])
    return Stem(points, radius, height)


@dataclass
class TrunkDiameter:
    """A measured diameter and what it rests on; lengths in the cloud's unit."""

    height: float  # over the foot, at which it was measured
    diameter: float
    # center, axis: (3,) float64: of the section, and unit direction of the stem there
    center: np.ndarray
    axis: np.ndarray
    terms: Terms  # what its error follows; empty when the skeleton's radius had to stand in
    arc_deg: float = 0.0  # covered by points
    residual: float = 0.0  # robust standard deviation of the points around the surface
    n_points: int = 0
    source: str = "points"  # or ``skeleton``


def measure_diameter(
    stem: Stem, wood: np.ndarray, height: float, *, rng: np.random.Generator
) -> TrunkDiameter:
    """Measure the stem's diameter at a height over the foot on the points around it.

    The wood, (n_wood, 3), are the points labelled trunk or branch; those of a slab across
    the stem count.

    Raises
    ------
    StageError
        If too few points, too little arc, or no circle is there.
    """
    guess = stem.radius_around(height)
    half_height = min(SPAN_M, max(height, SPAN_M / 2))
    span, sizes = max(half_height, 2 * guess), (0.3 * guess, 2.5 * guess + 0.01)
    center, axis = stem.line.at(height), stem.line.direction(height - span, height + span)
    slab = center, axis, half_height, 3.0 * guess + 0.03
    fit, frame = stem_section(wood, slab, FIRST_SCATTER * guess, sizes, rng)
    if fit.n_inliers < FEWEST_POINTS or fit.arc_deg < _LEAST_ARC_DEG:
        raise StageError(
            f"{fit.n_inliers} points over {fit.arc_deg:.0f} degrees fit a stem at height "
            f"{height:.2f}, {FEWEST_POINTS} over {_LEAST_ARC_DEG:.0f} needed"
        )
    rests_on = trunk_terms(fit), fit.arc_deg, fit.noise, fit.n_inliers
    center = center + fit.parameters[:2] @ frame[:2]
    return TrunkDiameter(height, 2.0 * fit.radius, center, axis, *rests_on)


def measure_near(
    stem: Stem, wood: np.ndarray, height: float, *, max_shift: float = _MOST_SHIFT_M, **options: Any
) -> TrunkDiameter:
    """`measure_diameter` at a height or, where that fails, at the nearest where it works.

    It is the skeleton's (``source`` tells) where no height within `max_shift` works.
    """
    wanted = min(height, stem.top)  # a trunk that ends below is searched downwards from its end
    step = SPAN_M / 2
    steps = np.arange(1, round(max_shift / step) + 1) * step
    for at in [wanted, *(wanted + np.outer(steps, [1, -1]).ravel())]:
        if min(step, stem.top / 2) <= at <= stem.top:
            try:
                return measure_diameter(stem, wood, float(at), **options)
            except StageError as error:
                logger.info("no trunk diameter: %s", error.cause)
    at = float(np.clip(wanted, *stem.height[[0, -1]]))
    direction = stem.line.direction(at - 0.1, at + 0.1)
    diameter = 2.0 * stem.radius_around(at)
    return TrunkDiameter(at, diameter, stem.line.at(at), direction, {}, source="skeleton")
