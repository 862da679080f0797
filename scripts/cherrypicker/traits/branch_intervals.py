"""90 % intervals of a branch's base diameter and insertion angle, from how its points scatter.

Points along a branch share errors (photogrammetry moves whole surfaces, the contraction bends whole
stretches), so drawing points again tells too little. The intervals follow the scatter of the points
around the fitted radius instead; the factors were set on generated trees with known branches, see
docs/traits.md.
"""

import numpy as np

__all__ = ["angle_interval", "diameter_interval", "typical_scatter"]

_Z90 = 1.645  # half a 90 % interval of a normal distribution, in standard deviations
_SHARED = 0.8  # error of a diameter over the scatter of the points that it rests on
_THIN = 2.5  # its growth where the scatter is no longer small beside the radius
_LEAST_ANGLE_DEG = 1.6
_BEND = 10.0  # error of a direction over that of a line through as many independent points
_LEAST_POINTS = 3


def typical_scatter(skeleton):
    """Median scatter of the points around the skeleton's radii; None where that is not known.

    Parameters
    ----------
    skeleton : Skeleton
        With the field ``residual``, 0 where no radius was fitted.

    Returns
    -------
    float or None
    """
    scatter = skeleton.fields.get("residual", np.zeros(0))
    scatter = scatter[scatter > 0]
    return float(np.median(scatter)) if len(scatter) else None


def diameter_interval(diameter, scatter, scale_error=0.0):
    """90 % interval of a diameter.

    Parameters
    ----------
    diameter, scatter : float
        The diameter and the standard deviation of the points around it, in one unit.
    scale_error : float, default 0
        Relative standard error of the scan's scale.

    Returns
    -------
    low, high : float
    """
    thickness = max(diameter, 1e-9)
    error = scatter * np.hypot(_SHARED, _THIN * 2.0 * scatter / thickness)
    half = _Z90 * float(np.hypot(error, scale_error * diameter))
    return max(diameter - half, 0.0), diameter + half


def angle_interval(angle_deg, scatter, n_points, stretch):
    """90 % interval of an angle to a branch's direction.

    Parameters
    ----------
    angle_deg : float
    scatter : float
        Standard deviation of the points around the branch's surface.
    n_points : float
        Points behind a radius.
    stretch : float
        Length that the direction is taken over, in the unit of `scatter`.

    Returns
    -------
    low, high : float
        Degrees, within 0 to 180.
    """
    slope = scatter / (max(stretch, 1e-9) * np.sqrt(max(n_points, _LEAST_POINTS)))
    half = _Z90 * float(np.hypot(_LEAST_ANGLE_DEG, _BEND * np.degrees(slope)))
    return max(angle_deg - half, 0.0), min(angle_deg + half, 180.0)
