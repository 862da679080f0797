"""Radii of skeleton nodes from the original surface points."""

import logging

import numba
import numpy as np

from cherrypicker.skeleton.edge_search import nearest_edges
from cherrypicker.skeleton.ordering import median
from cherrypicker.skeleton.tree_walks import (
    child_rows,
    fill_reach,
    longest_children,
    tangents,
    window,
)

__all__ = ["assign_surface", "fit_circle", "fit_radii", "local_tangents"]

logger = logging.getLogger(__name__)

FEWEST_POINTS = 5
ARC_SECTORS = 24
LEAST_ARC = 150.0  # a circle on less of the circumference says little about its centre
MOST_SLICE_POINTS = 600
CLEAR_ARC, CLEAR_SPREAD, FEWEST_CLEAR = 240.0, 0.25, 10  # circles that tell the noise
CLEAR_QUANTILE = 0.25  # bark, flutes and bends scatter points as well: the calmer circles count
RAYLEIGH_SPREAD = 0.6  # robust spread of the distances from an axis without radius, over the noise
LEAST_SHARE = 0.3  # of the distance of its points that a radius has
SETTLED = 1e-3  # share of its radius that a circle moves less than in its last round


def local_tangents(skeleton, reach):
    """Direction of the skeleton at each node, from the nodes within `reach` along its own axis.

    Parameters
    ----------
    skeleton : Skeleton
    reach : ndarray of shape (n_nodes,) or float
        How far to look each way, in the skeleton's unit.

    Returns
    -------
    ndarray of shape (n_nodes, 3), float64
        Unit vectors, from the root outwards.
    """
    reach = np.broadcast_to(np.asarray(reach, dtype=np.float64), (len(skeleton),))
    length, parent = skeleton.edge_length, skeleton.parent
    heir = longest_children(parent, fill_reach(parent, length) + length)
    found = tangents(skeleton.points, parent, length, heir, reach)
    found[~found.any(axis=1)] = (0.0, 0.0, 1.0)
    return found


def assign_surface(skeleton, surface):
    """Node of the nearest edge of the skeleton to each surface point.

    Parameters
    ----------
    skeleton : Skeleton
    surface : ndarray of shape (n_points, 3)

    Returns
    -------
    node : ndarray of shape (n_points,), int64
        Nearer end of the nearest edge.
    distance : ndarray of shape (n_points,), float64
        Distance to that edge.
    """
    node, share, distance = nearest_edges(skeleton, surface)
    return np.where(share <= 0.5, node, np.maximum(skeleton.parent[node], 0)), distance


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


def _without_noise(fits, is_final):
    """Radii less what noise adds to them.

    Points at r from an axis, with noise s across it, lie at distances of a Rice distribution, whose
    squared median is r^2 + s^2 where r is large and 1.386 s^2 where it is none. Wood thinner than
    the noise hides it: the distances then scatter by less than s. So s is the scatter around the
    clear circles of thicker wood, but no more than thin wood's own scatter allows for.
    """
    radius, spread, is_circle = fits[:, 0], fits[:, 4], fits[:, 5] > 0
    clear = is_circle & (fits[:, 3] >= CLEAR_ARC) & (spread < CLEAR_SPREAD * radius)
    noise = spread
    if is_final and np.count_nonzero(clear) >= FEWEST_CLEAR:
        noise = np.maximum(spread, np.quantile(spread[clear], CLEAR_QUANTILE))
        noise = np.where(is_circle, spread, np.minimum(noise, spread / RAYLEIGH_SPREAD))
    squared, noise = radius**2, np.maximum(noise, 1e-12) ** 2
    found = squared - noise
    if not is_final:
        return np.sqrt(np.maximum(found, 0.25 * squared))
    for _ in range(3):
        share = 0.386 * np.exp(-np.maximum(found, 0.0) / (2 * noise))
        found = squared - noise * (1 + np.where(is_circle, 0.0, share))
    return np.sqrt(np.maximum(found, LEAST_SHARE**2 * squared))


@numba.njit(cache=True)
def _fit_nodes(surface, start, tree, reach, nodes, along, most_points):
    """`_fit_slice` at every node; rows of `surface` are sorted by their node."""
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


def fit_radii(
    skeleton, surface, *, spacing, max_radius, least_radius=0.001, recentre=True, is_final=False
):
    """Radius of each node, and its place on the axis, from the surface points around it.

    The points nearest to the node and its neighbours within a radius along the axis are
    projected along the axis's direction. Where they cover half the circumference, a robust circle
    gives radius and centre; else, and on wood too thin for the noise, the radius is the median
    distance to the axis. Nodes without points take the radius along their path.

    Parameters
    ----------
    skeleton : Skeleton
    surface : ndarray of shape (n_points, 3)
        Wood points of the original cloud, same frame.
    spacing : float
        Distance between nodes.
    max_radius : float
        Surface points farther than this from the skeleton are left out.
    least_radius : float, default 0.001
    recentre : bool, default True
        Move nodes to the centre of their circles.
    is_final : bool, default False
        Take the noise that the clear circles of thick wood show off thin wood as well. Pruning
        compares points with radii that do not.

    Returns
    -------
    Skeleton
        With `radius` and the fields ``n_points``, ``arc_deg``, ``residual``.
    """
    n_nodes = len(skeleton)
    owner, distance = assign_surface(skeleton, surface)
    near = distance <= max_radius
    owner, distance, surface = owner[near], distance[near], surface[near]
    order = np.argsort(owner, kind="stable")
    start = np.searchsorted(owner[order], np.arange(n_nodes + 1))
    first_guess = _first_radii(distance[order], start, spacing)
    reach = np.clip(1.5 * first_guess, 1.5 * spacing, None)
    tree = skeleton.parent, skeleton.edge_length, *child_rows(skeleton.parent)
    along = local_tangents(skeleton, 2 * reach)
    fits, centres, n_points = _fit_nodes(
        surface[order], start, tree, reach, skeleton.points, along, MOST_SLICE_POINTS
    )
    arc, residual = np.nan_to_num(fits[:, 3]), np.nan_to_num(fits[:, 4])
    radius = np.full(n_nodes, np.nan)
    known = np.isfinite(fits[:, 0])
    radius[known] = _without_noise(fits[known], is_final)
    centre = centres if recentre else skeleton.points
    radius = np.maximum(_fill_along_paths(skeleton, radius), least_radius)
    fields = dict(skeleton.fields, n_points=n_points, arc_deg=arc, residual=residual)
    return type(skeleton)(
        centre, skeleton.parent, radius, skeleton.label, fields, skeleton.unit, skeleton.frame
    )


@numba.njit(cache=True)
def _first_radii(distance, start, spacing):
    """Median distance of the points that each node owns; the spacing where there are none.

    Reorders the distances of each node.
    """
    guess = np.full(len(start) - 1, spacing)
    for node in range(len(guess)):
        if start[node + 1] > start[node]:
            own = distance[start[node] : start[node + 1]]
            guess[node] = median(own)
    return guess


def _fill_along_paths(skeleton, radius):
    """Radii of nodes without points, between the nearest ones known below and above."""
    known = np.isfinite(radius)
    if known.all() or not known.any():
        return np.where(known, radius, 0.0)
    return _filled(radius, known, skeleton.parent, skeleton.edge_length, skeleton.reach())


@numba.njit(cache=True)
def _filled(radius, known, parent, length, reach):
    n = len(radius)
    below, to_below = radius.copy(), np.full(n, np.inf)
    for node in range(n):
        to_below[node] = 0.0 if known[node] else np.inf
    above, to_above = radius.copy(), to_below.copy()
    longest = np.full(n, -1.0)
    for node in range(n - 1, 0, -1):  # the longest way up decides what lies above
        up, way = parent[node], reach[node] + length[node]
        if not known[up] and np.isfinite(to_above[node]) and way > longest[up]:
            longest[up] = way
            above[up], to_above[up] = above[node], to_above[node] + length[node]
    filled = radius.copy()
    for node in range(n):
        if known[node]:
            continue
        if node:
            below[node] = below[parent[node]]
            to_below[node] = to_below[parent[node]] + length[node]
        lower = 1 / max(to_below[node], 1e-9) if np.isfinite(to_below[node]) else 0.0
        upper = 1 / max(to_above[node], 1e-9) if np.isfinite(to_above[node]) else 0.0
        value = lower * below[node] if lower > 0 else 0.0
        value += upper * above[node] if upper > 0 else 0.0
        filled[node] = value / max(lower + upper, 1e-30)
    return filled
