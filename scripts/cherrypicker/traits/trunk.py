"""Diameters of the trunk at given heights, measured on the original points.

The skeleton only says where the stem is; radius and centre come from the labelled surface points
of a slab across the stem's local axis, so that a leaning stem is cut at right angles. Points of
other classes (calibration ring, post, sign) are left out; those that the network missed are
outliers of the robust fit.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.geometry.sections import Section
from cherrypicker.geometry.stem_slabs import cut_slab, section_of, steady_levels
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.foot import Foot
from cherrypicker.traits.intervals import Terms

__all__ = ["Stem", "TrunkDiameter", "measure_diameter", "stem_of"]

logger = logging.getLogger(__name__)

_MAX_POINTS = 4000
_LYING_DEG = 60.0
_RECUT_DEG = 2.0


@dataclass
class Stem:
    """The trunk's skeleton as a function of height.

    Attributes
    ----------
    points : ndarray of shape (n, 3), float64
        Polyline from the foot to the trunk's end.
    radius : ndarray of shape (n,), float64
    height : ndarray of shape (n,), float64
        Height over the foot (along the stem, for a lying one), increasing.
    is_lying : bool
        The stem leans more than 60 degrees: heights run along it.
    """

    points: np.ndarray
    radius: np.ndarray
    height: np.ndarray
    is_lying: bool

    def at(self, height: float) -> np.ndarray:
        """Point on the stem at a height, clipped to its ends."""
        return np.array([np.interp(height, self.height, axis) for axis in self.points.T])

    def direction(self, height: float, span: float) -> np.ndarray:
        """Unit direction of the stem around a height, over `span` below and above it."""
        low = max(height - span, self.height[0])
        high = min(height + span, self.height[-1])
        low, high = (low, high) if high > low else (self.height[0], self.height[-1])
        heights = np.linspace(low, high, 9)
        samples = np.array([self.at(h) for h in heights])
        slope = np.polyfit(heights, samples, 1)[0]
        norm = np.linalg.norm(slope)
        return slope / norm if norm > 0 else np.array([0.0, 0.0, 1.0])

    def radius_around(self, height: float, span: float = 0.15) -> float:
        """Median skeleton radius within `span` of a height."""
        near = np.abs(self.height - height) <= span
        if not near.any():
            near = np.abs(self.height - height) == np.abs(self.height - height).min()
        return float(np.median(self.radius[near]))


@dataclass
class TrunkDiameter:
    """A measured diameter and what it rests on; lengths in the cloud's unit.

    Attributes
    ----------
    height : float
        Height over the foot at which it was measured.
    diameter : float
    terms : Terms
        What its error follows; empty when the skeleton's radius had to stand in.
    center, axis : ndarray of shape (3,)
        Centre of the section and unit direction of the stem there.
    arc_deg, residual, n_points : float, float, int
        Arc covered, robust standard deviation of the points around the surface, points used.
    source : str
        ``points`` or ``skeleton``.
    """

    height: float
    diameter: float
    terms: Terms
    center: np.ndarray
    axis: np.ndarray
    arc_deg: float
    residual: float
    n_points: int
    source: str


def stem_of(skeleton: Skeleton, trunk_nodes: np.ndarray, foot: Foot) -> Stem:
    """Return the :class:`Stem` along the trunk's nodes (root first) over the foot."""
    points, radius = skeleton.points[trunk_nodes], skeleton.radius[trunk_nodes]
    rise = points[-1] - points[0]
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    is_lying = len(points) > 1 and rise[2] < np.cos(np.radians(_LYING_DEG)) * steps.sum()
    height = np.concatenate([[0.0], np.cumsum(steps)]) if is_lying else points[:, 2] - foot.point[2]
    # A noisy stem may dip; only nodes that rise above all before them define heights.
    rises = np.concatenate([[True], height[1:] > np.maximum.accumulate(height)[:-1]])
    points, radius, height = points[rises], radius[rises], height[rises]
    if not is_lying and height[0] > 0.01:
        points = np.vstack([[points[0, 0], points[0, 1], foot.point[2]], points])
        radius, height = np.concatenate([radius[:1], radius]), np.concatenate([[0.0], height])
    return Stem(points, radius, height, bool(is_lying))


def measure_diameter(
    stem: Stem,
    wood: np.ndarray,
    height: float,
    *,
    half_height: float,
    min_points: int,
    min_arc_deg: float,
    rng: np.random.Generator,
) -> TrunkDiameter:
    """Measure the stem's diameter at a height on the points around it.

    Parameters
    ----------
    stem : Stem
    wood : ndarray of shape (n_wood, 3), float64
        Points labelled trunk or branch.
    height : float
        Height over the foot, in the cloud's unit.
    half_height : float
        Half the height of the slab of points used.
    min_points, min_arc_deg : int, float
        Fewer points or less arc than this make no measurement.
    rng : numpy.random.Generator

    Returns
    -------
    TrunkDiameter

    Raises
    ------
    StageError
        If too few points, too little arc, or no circle is there.
    """
    guess = stem.radius_around(height)
    half_height = min(half_height, max(height - 0.02, 0.5 * half_height))
    center, axis = stem.at(height), stem.direction(height, max(half_height, 2 * guess))
    fit, frame = _fit_slab(wood, center, axis, guess, half_height, min_points, rng)
    tilt = np.array([fit.parameters[3], fit.parameters[4], 1.0])
    if np.linalg.norm(tilt[:2]) > np.tan(np.radians(_RECUT_DEG)):
        # The points know the axis better than the skeleton: cut again, at right angles to it.
        center, axis = center + fit.parameters[:2] @ frame[:2], tilt @ frame
        axis /= np.linalg.norm(axis)
        fit, frame = _fit_slab(wood, center, axis, guess, half_height, min_points, rng)
    if fit.n_inliers < min_points or fit.arc_deg < min_arc_deg:
        raise StageError(
            f"{fit.n_inliers} points over {fit.arc_deg:.0f} degrees fit a stem at height "
            f"{height:.2f}, {min_points} over {min_arc_deg:.0f} needed"
        )
    if not 0.25 * guess <= fit.radius <= 4.0 * guess + 0.01:
        raise StageError(f"the stem fitted at height {height:.2f} is far from its skeleton")
    return TrunkDiameter(
        height,
        2.0 * fit.radius,
        _terms(fit),
        center + fit.parameters[:2] @ frame[:2],
        axis,
        fit.arc_deg,
        fit.noise,
        fit.n_inliers,
        "points",
    )


def _terms(fit: Section) -> Terms:
    """What the diameter's error follows, beside the fit's own.

    Photogrammetry moves a whole surface outwards or inwards by a part of the scatter that it shows,
    and a smooth one is off by a part of its diameter all the same; no fit sees that.
    """
    return {
        "fit": 2.0 * fit.error,
        "trunk_shared": fit.noise,
        "trunk_hidden": 2.0 * fit.radius,
    }


def _fit_slab(
    wood: np.ndarray,
    center: np.ndarray,
    axis: np.ndarray,
    guess: float,
    half_height: float,
    min_points: int,
    rng: np.random.Generator,
) -> tuple[Section, np.ndarray]:
    """Fit a section to the slab of wood across `axis` at `center`: fit and frame."""
    local, frame = cut_slab(wood, center, axis, half_height, 3.0 * guess + 0.03)
    if len(local) < min_points:
        raise StageError(f"{len(local)} stem points around z = {center[2]:.2f}, not {min_points}")
    if len(local) > _MAX_POINTS:
        local = local[rng.choice(len(local), _MAX_POINTS, replace=False)]
    tolerance = np.clip(0.15 * guess, 0.002, 0.02)
    radius_range = (0.3 * guess, 2.5 * guess + 0.01)
    fit = section_of(local, tolerance, radius_range, rng, waves=False)
    local = local[steady_levels(local, fit)]
    fit = section_of(local, tolerance, radius_range, rng, waves=True)
    if _ends_before(local[fit.weights > 0, 2]):
        raise StageError(f"the stem points around z = {center[2]:.2f} end above or below it")
    return fit, frame


def _ends_before(along: np.ndarray) -> bool:
    """Whether points at heights about a slab's middle leave the middle out.

    A stem that is hidden there leaves points at one end of the slab, from which a tapering section
    would be carried on over the gap. Points spread evenly reach sqrt(3) standard deviations from
    their mean.
    """
    return bool(abs(along.mean()) > np.sqrt(3.0) * along.std())


def diameter_from_skeleton(stem: Stem, height: float) -> TrunkDiameter:
    """A diameter from the skeleton's radius, for a stem whose points allow no fit."""
    height = float(np.clip(height, stem.height[0], stem.height[-1]))
    return TrunkDiameter(
        height,
        2.0 * stem.radius_around(height),
        {},
        stem.at(height),
        stem.direction(height, 0.1),
        0.0,
        0.0,
        0,
        "skeleton",
    )


def measure_near(
    stem: Stem,
    wood: np.ndarray,
    height: float,
    *,
    max_shift: float = 0.2,
    step: float = 0.05,
    **options: Any,
) -> TrunkDiameter:
    """Measure at a height or, where that fails, at the nearest height where it works.

    Returns
    -------
    TrunkDiameter
        From the skeleton's radius (``source`` tells) where no height within `max_shift` works.
    """
    end = stem.height[-1] if stem.is_lying else max(stem.height[-1] - 0.02, 0.0)
    shifts = [0.0]
    for i in range(1, int(round(max_shift / step)) + 1):
        shifts += [i * step, -i * step]
    wanted = min(height, end)  # a trunk that ends below is searched downwards from its end
    for shift in shifts:
        at = wanted + shift
        if at > end or at < min(0.05, 0.5 * end):
            continue
        try:
            return measure_diameter(stem, wood, at, **options)
        except StageError as error:
            logger.info("no trunk diameter: %s", error.cause)
    return diameter_from_skeleton(stem, wanted)
