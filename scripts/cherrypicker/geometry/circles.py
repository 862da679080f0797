"""Circles through the points of a slice of wood, plain and robust (compiled)."""

import numba
import numpy as np

from cherrypicker.geometry.ordering import median

__all__ = ["FEWEST_POINTS", "fit_circle", "fit_slice"]

FEWEST_POINTS = 5
ARC_SECTORS = 24
LEAST_ARC = 150.0  # a circle on less of the circumference says little about its centre
SETTLED = 1e-3  # share of its radius that a circle moves less than in its last round


def fit_circle(xy, weights=None):
    """Algebraic least-squares circle.

    Parameters
    ----------
    xy : ndarray of shape (n_points, 2)
    weights : ndarray of shape (n_points,), optional

    Returns
    -------
    centre : ndarray of shape (2,), float64
    radius : float
        NaN where the points lie on a line.
    """
    xy = np.ascontiguousarray(xy, dtype=np.float64)
    weights = np.ones(len(xy)) if weights is None else np.asarray(weights, dtype=np.float64)
    x, y, radius = _circle(xy[:, 0].copy(), xy[:, 1].copy(), weights)
    return np.array([x, y]), radius


@numba.njit(cache=True)
def _circle(x, y, w):
    """Weighted algebraic circle: centre x, centre y, radius (NaN if the points are in line)."""
    total = mx = my = 0.0
    for row in range(len(x)):
        total += w[row]
        mx += w[row] * x[row]
        my += w[row] * y[row]
    mx, my = mx / total, my / total
    suu = svv = suv = suq = svq = sq = 0.0
    for row in range(len(x)):
        u, v = x[row] - mx, y[row] - my
        q = u * u + v * v
        suu += w[row] * u * u
        svv += w[row] * v * v
        suv += w[row] * u * v
        suq += w[row] * u * q
        svq += w[row] * v * q
        sq += w[row] * q
    determinant = suu * svv - suv * suv
    trace = suu + svv
    if trace <= 0 or determinant < 1e-8 * trace * trace:
        return mx, my, np.nan
    a = (suq * svv - svq * suv) / determinant / 2
    b = (svq * suu - suq * suv) / determinant / 2
    return mx + a, my + b, np.sqrt(a * a + b * b + sq / total)


@numba.njit(cache=True)
def _off_circle(x, y, cx, cy, radius, off, copy):
    """Distance of points from a circle, written to `off` and to `copy`."""
    for row in range(len(x)):
        off[row] = abs(np.sqrt((x[row] - cx) ** 2 + (y[row] - cy) ** 2) - radius)
        copy[row] = off[row]


@numba.njit(cache=True)
def _robust_circle(x, y, n_rounds):
    """Circle with Tukey weights: outliers and a neighbour's points lose their say."""
    weights, off, scratch = np.ones(len(x)), np.empty(len(x)), np.empty(len(x))
    cx, cy, radius = _circle(x, y, weights)
    for _ in range(n_rounds):
        if not np.isfinite(radius):
            break
        _off_circle(x, y, cx, cy, radius, off, scratch)
        limit = 4.0 * max(1.4826 * median(scratch), 1e-9)
        n_used = 0
        for row in range(len(x)):
            weights[row] = max(1 - (off[row] / limit) ** 2, 0.0) ** 2
            n_used += weights[row] > 0
        if n_used < FEWEST_POINTS:
            break
        before_x, before_y, before_radius = cx, cy, radius
        cx, cy, radius = _circle(x, y, weights)
        moved = abs(cx - before_x) + abs(cy - before_y) + abs(radius - before_radius)
        if moved < SETTLED * before_radius:
            break
    return cx, cy, radius


@numba.njit(cache=True)
def _arc_deg(x, y, cx, cy):
    """Part of the circumference that points around a centre cover, degrees."""
    seen, n_seen = np.zeros(ARC_SECTORS, dtype=np.int64), 0
    for row in range(len(x)):
        turn = (np.arctan2(y[row] - cy, x[row] - cx) + np.pi) / (2 * np.pi)
        seen[int(turn * ARC_SECTORS) % ARC_SECTORS] = 1
    for sector in range(ARC_SECTORS):
        n_seen += seen[sector]
    return 360.0 * n_seen / ARC_SECTORS


@numba.njit(cache=True)
def fit_slice(x, y):
    """Radius, centre x, centre y, covered arc, residual of one slice; whether it is a circle's."""
    away = np.empty(len(x))
    for row in range(len(x)):
        away[row] = np.sqrt(x[row] * x[row] + y[row] * y[row])
    simple = median(away)
    for row in range(len(x)):
        away[row] = abs(away[row] - simple)
    spread = 1.4826 * median(away)
    if len(x) >= 3 * FEWEST_POINTS:
        cx, cy, radius = _robust_circle(x, y, 6)
        shift = np.sqrt(cx * cx + cy * cy)
        if radius > 0 and radius <= 1.6 * simple and shift <= 1.2 * simple:
            arc = _arc_deg(x, y, cx, cy)
            _off_circle(x, y, cx, cy, radius, away, away)
            residual = 1.4826 * median(away)
            if arc >= LEAST_ARC and residual <= 0.35 * radius and residual <= 1.05 * spread:
                return radius, cx, cy, arc, residual, 1.0
    return simple, 0.0, 0.0, _arc_deg(x, y, 0.0, 0.0), spread, 0.0
