"""Crown volumes as the field reckons them from few measures, beside hull and alpha volume.

A cone and an ellipsoid take the crown's width and depth alone. Culver and Till (Australian Journal
of Experimental Agriculture and Animal Husbandry 7:587-592, 1967) measured five widths of the
profile on each of eight radials and found no form needed; so does the contour here. The tree row
volume is that of a hedge as high and wide as the tree (Sutton and Unrath, Plant Disease 68:480-484,
1984).
"""

from __future__ import annotations

import numpy as np

_N_RADIALS, _N_LEVELS = 8, 5  # of the contour (Culver and Till 1967)
_HECTARE_M2 = 1e4


def cone_volume(width: float, depth: float) -> float:
    """Volume of an upright cone."""
    return np.pi / 12.0 * width**2 * depth


def ellipsoid_volume(width: float, depth: float) -> float:
    """Volume of an upright ellipsoid that is as wide both ways."""
    return np.pi / 6.0 * width**2 * depth


def contour_volume(points: np.ndarray, middle: np.ndarray) -> float:
    """Volume within a crown's outline: eight radials from the stem at each of five levels.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
        Of the crown.
    middle : ndarray of shape (2,)
        x and y of the stem.

    Returns
    -------
    float
        Sum over the levels of the areas of eight sectors, each as wide as the farthest point in it,
        times a level's height; 0 without points.
    """
    if not len(points):
        return 0.0
    low, depth = points[:, 2].min(), np.ptp(points[:, 2])
    level = ((points[:, 2] - low) / max(depth, 1e-12) * _N_LEVELS).astype(int)
    level = np.minimum(level, _N_LEVELS - 1)
    x, y = (points[:, :2] - middle).T
    radial = np.floor((np.arctan2(y, x) / (2 * np.pi) + 0.5) * _N_RADIALS).astype(int)
    widest = np.zeros((_N_LEVELS, _N_RADIALS))
    np.maximum.at(widest, (level, radial % _N_RADIALS), x**2 + y**2)
    return float(np.pi / _N_RADIALS * widest.sum() * depth / _N_LEVELS)


def tree_row_volume(height: float, width: float, row_distance: float) -> float:
    """Volume of a row of such trees, m³ a hectare."""
    return height * width * _HECTARE_M2 / row_distance
