"""Radii along the axes of a skeleton, from the surface points around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cherrypicker.compiled import compiled
from cherrypicker.geometry.edge_search import nearest_edges
from cherrypicker.geometry.ordering import median
from cherrypicker.geometry.robust import MAD_TO_SIGMA
from cherrypicker.geometry.sections import arc_deg, iterate, judge
from cherrypicker.geometry.tree_walks import (
    child_rows,
    fill_reach,
    longest_children,
    tangents,
    window,
)
from cherrypicker.skeleton.model import Skeleton

__all__ = ["fit_axis_radii"]

MOST_POINTS = 300  # of a section
SETTLED = 1e-3  # share of its radius that a section moves less than in its last round
FEWEST_POINTS = 5
LEAST_RADIUS_M = 0.001  # thinner wood is not seen; a guess
OFF_AXIS = 0.5  # of the points' distance: what the axis is off by, one standard deviation; a guess
ARC_SECTORS = 24
CLEAR_ARC, CLEAR_NOISES, FEWEST_CLEAR = 240.0, 4.0, 10  # sections that tell the noise
CLEAR_QUANTILE = 0.25  # bark, flutes and bends scatter points as well: the calmer sections count


def _local_tangents(skeleton: Skeleton, reach: np.ndarray | float) -> np.ndarray:
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


def _assign_surface(skeleton: Skeleton, surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


def fit_axis_radii(
    skeleton: Skeleton,
    surface: np.ndarray,
    *,
    spacing: float,
    max_radius: float,
) -> Skeleton:
    """Radius of each node from the surface points around it.

    The points nearest to the node and its neighbours within a radius along the axis are projected
    along the axis's direction and a circle is fitted. Where they cover little of the circumference,
    its centre stays near the axis. What wood thinner than the noise hides of it is made up for by
    the noise of clear sections. Nodes without points take the radius along their path.

    Parameters
    ----------
    skeleton : Skeleton
    surface : ndarray of shape (n_points, 3)
        Wood points of the original cloud, same frame.
    spacing : float
        Distance between nodes.
    max_radius : float
        Surface points farther than this from the skeleton are left out.

    Returns
    -------
    Skeleton
        With `radius` and the fields ``n_points``, ``arc_deg``, ``residual`` (the scatter of the
        points around the circle) and ``radius_error``, zero where there is no fit.
    """
    n_nodes = len(skeleton)
    owner, distance = _assign_surface(skeleton, surface)
    near = distance <= max_radius
    owner, distance, surface = owner[near], distance[near], surface[near]
    order = np.argsort(owner, kind="stable")
    start = np.searchsorted(owner[order], np.arange(n_nodes + 1))
    first_guess = _first_radii(distance[order], start, spacing)
    reach = np.clip(1.5 * first_guess, 1.5 * spacing, None)
    tree = skeleton.parent, skeleton.edge_length, *child_rows(skeleton.parent)
    along = _local_tangents(skeleton, 2 * reach)
    arrays = surface[order], start, tree, reach, skeleton.points, along
    fits, n_points = _fit_nodes(*arrays, 0.0, CLEAR_NOISES)
    clear = (fits[:, 1] >= CLEAR_ARC) & (fits[:, 0] > CLEAR_NOISES * fits[:, 2])
    is_told = np.count_nonzero(clear) >= FEWEST_CLEAR
    noise = float(np.quantile(fits[clear, 2], CLEAR_QUANTILE)) if is_told else 0.0
    fits, n_points = _fit_nodes(*arrays, noise, 0.0)
    radius = np.maximum(_fill_along_paths(skeleton, fits[:, 0]), LEAST_RADIUS_M)
    arc, residual, error = np.nan_to_num(fits[:, 1:]).T
    fields = {"n_points": n_points, "arc_deg": arc, "residual": residual, "radius_error": error}
    return replace(skeleton, radius=radius, fields=skeleton.fields | fields)


@compiled
def _fit_nodes(
    surface: np.ndarray,
    start: np.ndarray,
    tree: tuple,
    reach: np.ndarray,
    nodes: np.ndarray,
    along: np.ndarray,
    noise: float,
    least: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Circles across an axis at every node of a skeleton, from the surface points around it.

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
    noise : float
        Least scatter of the points around a circle.
    least : float
        In scatters of the points' distances: nodes of thinner wood are left out.

    Returns
    -------
    fits : ndarray of shape (n_nodes, 4), float64
        Radius, covered arc in degrees, scatter, standard error of the radius; NaN where there are
        too few points.
    counts : ndarray of shape (n_nodes,), int64
    """
    parent, length, child_start, child = tree
    n_nodes = len(nodes)
    fits, counts = np.full((n_nodes, 4), np.nan), np.zeros(n_nodes, dtype=np.int64)
    near = np.empty(n_nodes, dtype=np.int64)
    u, v, local, away, even = np.empty(3), np.empty(3), np.zeros((1, 3)), np.zeros(1), np.ones(1)
    first, expected = np.zeros(3), np.full(3, np.inf)
    for node in range(n_nodes):
        n_near = window(node, parent, length, child_start, child, reach[node], near)
        for at in range(n_near):
            counts[node] += start[near[at] + 1] - start[near[at]]
        if counts[node] < FEWEST_POINTS:
            continue
        stride = 1 + counts[node] // MOST_POINTS
        _across(along[node, 0], along[node, 1], along[node, 2], u, v)
        if counts[node] > len(local):
            n = 2 * counts[node]
            local, away, even = np.zeros((n, 3)), np.zeros(n), np.ones(n)
        n = 0
        for at in range(n_near):
            for row in range(start[near[at]], start[near[at] + 1], stride):
                local[n, 0] = local[n, 1] = 0.0
                for axis in range(3):
                    offset = surface[row, axis] - nodes[node, axis]
                    local[n, 0] += offset * u[axis]
                    local[n, 1] += offset * v[axis]
                away[n] = np.sqrt(local[n, 0] ** 2 + local[n, 1] ** 2)
                n += 1
        first[2] = median(away[:n])
        for row in range(n):
            away[row] = abs(away[row] - first[2])
        scatter = MAD_TO_SIGMA * median(away[:n])
        if first[2] < 0.5 * least * scatter:  # an axis off its circle scatters as well
            continue
        expected[0] = expected[1] = OFF_AXIS * first[2]
        own, alike = local[:n], even[:n]
        found, spread = iterate(own, first, first, expected, alike, scatter, noise, SETTLED)
        if np.isfinite(found[2]):
            _, offsets, covariance = judge(own, found, expected, alike, spread)
            fits[node, 1] = arc_deg(offsets, ARC_SECTORS)
            fits[node, 3] = np.sqrt(max(covariance[2, 2], 0.0))
        fits[node, 0] = found[2] if np.isfinite(found[2]) else first[2]
        fits[node, 2] = spread
    return fits, counts


@compiled
def _first_radii(distance: np.ndarray, start: np.ndarray, spacing: float) -> np.ndarray:
    """Median distance of the points that each node owns; the spacing where there are none.

    Reorders the distances of each node.
    """
    guess = np.full(len(start) - 1, spacing)
    for node in range(len(guess)):
        if start[node + 1] > start[node]:
            own = distance[start[node] : start[node + 1]]
            guess[node] = median(own)
    return guess


def _fill_along_paths(skeleton: Skeleton, radius: np.ndarray) -> np.ndarray:
    """Radii of nodes without points, between the nearest ones known below and above."""
    known = np.isfinite(radius)
    if known.all() or not known.any():
        return np.where(known, radius, 0.0)
    return _filled(radius, known, skeleton.parent, skeleton.edge_length, skeleton.reach())


@compiled
def _filled(
    radius: np.ndarray, known: np.ndarray, parent: np.ndarray, length: np.ndarray, reach: np.ndarray
) -> np.ndarray:
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


@compiled
def _across(x: float, y: float, z: float, u: np.ndarray, v: np.ndarray) -> None:
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
