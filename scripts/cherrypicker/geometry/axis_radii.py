"""Radii along the axes of a skeleton, from the surface points around them."""

import numba
import numpy as np

from cherrypicker.geometry.circles import fit_slices
from cherrypicker.geometry.edge_search import nearest_edges
from cherrypicker.geometry.ordering import median
from cherrypicker.geometry.tree_walks import (
    child_rows,
    fill_reach,
    longest_children,
    tangents,
)

__all__ = ["assign_surface", "fit_axis_radii", "less_spread", "local_tangents"]

MOST_SLICE_POINTS = 600


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


def less_spread(fits):
    """Radii less what the scatter of their own points adds to them.

    Parameters
    ----------
    fits : ndarray of shape (n_slices, 6), float64
        Rows of `fit_slices`.

    Returns
    -------
    ndarray of shape (n_slices,), float64
        Half the fitted radius at least.
    """
    squared, noise = fits[:, 0] ** 2, np.maximum(fits[:, 4], 1e-12) ** 2
    return np.sqrt(np.maximum(squared - noise, 0.25 * squared))


def fit_axis_radii(
    skeleton,
    surface,
    *,
    spacing,
    max_radius,
    least_radius=0.001,
    recentre=True,
    less_noise=less_spread,
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
    less_noise : callable, default less_spread
        Radii less what noise adds to them, from the rows of slices (see `fit_slices`) of nodes that
        have points.

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
    fits, centres, n_points = fit_slices(
        surface[order], start, tree, reach, skeleton.points, along, MOST_SLICE_POINTS
    )
    arc, residual = np.nan_to_num(fits[:, 3]), np.nan_to_num(fits[:, 4])
    radius = np.full(n_nodes, np.nan)
    known = np.isfinite(fits[:, 0])
    radius[known] = less_noise(fits[known])
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
