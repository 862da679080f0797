"""Circles through the points of a slice of wood, plain and robust (compiled)."""

import numba
import numpy as np

from cherrypicker.geometry.ordering import median
from cherrypicker.geometry.tree_walks import window

__all__ = ["fit_slices"]

FEWEST_POINTS = 5
ARC_SECTORS = 24
LEAST_ARC = 150.0  # a circle on less of the circumference says little about its centre
SETTLED = 1e-3  # share of its radius that a circle moves less than in its last round


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
def _fit_slice(x, y):
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


@numba.njit(cache=True)
def fit_slices(surface, start, tree, reach, nodes, along, most_points):
    """Circles across an axis at every node of a skeleton, from the surface points around it.

    In this module with all that it calls on circles: Numba's cache asks no other file for its age.

    Parameters
    ----------
    surface : ndarray of shape (n_points, 3), float64
        Sorted by the node that each point belongs to.
    start : ndarray of shape (n_nodes + 1,), int64
        First row of each node's points.
    tree : tuple
        Parents, lengths of the edges below, and `child_rows`.
    reach : ndarray of shape (n_nodes,), float64
        How far along the axis a node's points are taken from.
    nodes, along : ndarray of shape (n_nodes, 3), float64
        Places and directions.
    most_points : int
        Of a slice; of more, every second, third ... is taken.

    Returns
    -------
    fits : ndarray of shape (n_nodes, 6), float64
        Radius, centre (two coordinates across the axis), covered arc in degrees, residual, 1 where
        a circle fits; NaN where there are too few points.
    centres : ndarray of shape (n_nodes, 3), float64
    counts : ndarray of shape (n_nodes,), int64
    """
    parent, length, child_start, child = tree
    n_nodes = len(nodes)
    fits = np.full((n_nodes, 6), np.nan)
    centres = nodes.copy()
    counts = np.zeros(n_nodes, dtype=np.int64)
    near = np.empty(n_nodes, dtype=np.int64)
    u, v, x, y = np.empty(3), np.empty(3), np.empty(1), np.empty(1)
    for node in range(n_nodes):
        n_near = window(node, parent, length, child_start, child, reach[node], near)
        n_rows = 0
        for at in range(n_near):
            n_rows += start[near[at] + 1] - start[near[at]]
        counts[node] = n_rows
        if n_rows < FEWEST_POINTS:
            continue
        stride = 1 + n_rows // most_points
        _across(along[node, 0], along[node, 1], along[node, 2], u, v)
        if n_rows > len(x):
            x, y = np.empty(2 * n_rows), np.empty(2 * n_rows)
        filled = 0
        for at in range(n_near):
            for row in range(start[near[at]], start[near[at] + 1], stride):
                a = surface[row, 0] - nodes[node, 0]
                b = surface[row, 1] - nodes[node, 1]
                c = surface[row, 2] - nodes[node, 2]
                x[filled] = a * u[0] + b * u[1] + c * u[2]
                y[filled] = a * v[0] + b * v[1] + c * v[2]
                filled += 1
        fit = _fit_slice(x[:filled], y[:filled])
        for column in range(6):
            fits[node, column] = fit[column]
        for axis in range(3):
            centres[node, axis] += fit[1] * u[axis] + fit[2] * v[axis]
    return fits, centres, counts


@numba.njit(cache=True)
def _across(x, y, z, u, v):
    """Two directions across a unit vector and one another, written to `u` and `v`."""
    if abs(x) <= abs(y) and abs(x) <= abs(z):  # its cross product with the axis it is farthest from
        u[0], u[1], u[2] = 0.0, z, -y
    elif abs(y) <= abs(z):
        u[0], u[1], u[2] = -z, 0.0, x
    else:
        u[0], u[1], u[2] = y, -x, 0.0
    norm = np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    u[0], u[1], u[2] = u[0] / norm, u[1] / norm, u[2] / norm
    v[0], v[1], v[2] = y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0]
