"""90 % intervals of a branch's base diameter and insertion angle.

The fit of a radius tells its standard error. Points along a branch also share errors that no fit
sees (photogrammetry moves whole surfaces, the contraction bends whole stretches): these follow the
scatter of the points.
"""

from __future__ import annotations

import numpy as np

from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.interval_factors import FACTORS

Z90 = 1.645  # half a 90 % interval of a normal distribution, in standard deviations
_LEAST_POINTS = 3  # behind a direction


def typical_scatter(skeleton: Skeleton) -> float | None:
    """Median scatter of the points around the skeleton's radii; None where that is not known.

    Parameters
    ----------
    skeleton : Skeleton
        With the field ``residual``, 0 where no radius was fitted.
    """
    scatter = skeleton.fields.get("residual", np.zeros(0))
    scatter = scatter[scatter > 0]
    return float(np.median(scatter)) if len(scatter) else None


def diameter_interval(
    diameter: float | np.ndarray,
    error: float | np.ndarray,
    scatter: float | np.ndarray,
    scale_error: float = 0.0,
) -> tuple:
    """90 % interval of a diameter.

    Parameters
    ----------
    diameter, error, scatter : float or ndarray of shape (n,), float64
        The diameter, the standard error of the radius by its fit and the standard deviation of the
        points around it, in one unit.
    scale_error : float, default 0
        Relative standard error of the scan's scale.

    Returns
    -------
    low, high : float or ndarray of shape (n,), float64
    """
    error = np.hypot(2.0 * error, FACTORS["diameter_shared"] * scatter)
    half = Z90 * np.hypot(error, scale_error * diameter)
    return np.maximum(diameter - half, 0.0), diameter + half


def angle_interval(
    angle_deg: float | np.ndarray,
    scatter: float | np.ndarray,
    n_points: int | np.ndarray,
    stretch: float | np.ndarray,
) -> tuple:
    """90 % interval of an angle to a branch's direction.

    Parameters
    ----------
    angle_deg, scatter : float or ndarray of shape (n,), float64
        Angle, and standard deviation of the points around the branch's surface.
    n_points : float or ndarray of shape (n,)
        Points behind a radius.
    stretch : float or ndarray of shape (n,), float64
        Length that the direction is taken over, in the unit of `scatter`.

    Returns
    -------
    low, high : float or ndarray of shape (n,), float64
        Degrees, within 0 to 180.
    """
    length, n_points = np.maximum(stretch, 1e-9), np.maximum(n_points, _LEAST_POINTS)
    slope = scatter / (length * np.sqrt(n_points))
    half = Z90 * np.hypot(FACTORS["angle_least_deg"], FACTORS["angle_bend"] * np.degrees(slope))
    return np.maximum(angle_deg - half, 0.0), np.minimum(angle_deg + half, 180.0)
