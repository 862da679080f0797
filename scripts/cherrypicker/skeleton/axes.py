"""Axes of a skeleton: which child goes on at a junction, and the botanical order.

The trunk (order 0) goes on at a fork into the thickest axis while that axis, one stem diameter
above the fork, keeps at least 0.8 of the radius one diameter below it; else it ends there. Every
other axis goes on into its thickest child; the children that it leaves aside start axes of the
next order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from cherrypicker.geometry.ordering import median
from cherrypicker.geometry.tree_walks import child_rows, fill_reach
from cherrypicker.skeleton.model import Skeleton

__all__ = [
    "Axis",
    "axes",
    "axis_of_node",
    "axis_polyline",
    "axis_runs",
    "node_order",
]

TRUNK_KEEPS = 0.8  # share of the radius that a trunk keeps over a fork (docs/segmentation.md)
SIMILAR_RADIUS = 0.85  # children this close in radius are told apart by how far they reach (guess)
# Of these: how far one reaches times this plus the cosine of its turn, so that straight on counts
# 11 times as much as straight back (guess)
STRAIGHT_BASE = 1.2
TURN_REACH = 3.0  # the turn is taken over so many radii, or edges, on either side (guess)
# The radii of a child are taken from one radius of the junction on, over two; those of the trunk
# from half its diameter off a fork on, over a whole one: within a fork radii are no one's own
CHILD_STRETCH, TRUNK_SKIP = 2.0, 0.5


@dataclass
class Axis:
    """One axis: a run of nodes from its base to its tip.

    Attributes
    ----------
    nodes : ndarray of int64
        Node ids from base to tip, the attach node not included (the trunk's first is the root).
    order : int
        0 for the trunk, else the parent axis's order + 1.
    parent : int
        Index of the parent axis in the list, -1 for the trunk.
    attach : int
        Node of the parent axis that the first node hangs on, -1 for the trunk.
    """

    nodes: np.ndarray
    order: int
    parent: int
    attach: int


def axes(skeleton: Skeleton, *, trunk_keeps: float = TRUNK_KEEPS) -> list[Axis]:
    """Split a skeleton into axes.

    Parameters
    ----------
    skeleton : Skeleton
    trunk_keeps : float, default 0.8
        Least share of its radius that the trunk keeps over a fork, else it ends there.

    Returns
    -------
    list of Axis
        The trunk first, parents before children; every node is in exactly one axis.
    """
    nodes, first, *rest = axis_runs(skeleton, trunk_keeps=trunk_keeps)
    first = first.tolist()
    runs = [nodes[a:b] for a, b in zip(first[:-1], first[1:])]
    return [Axis(*axis) for axis in zip(runs, *(values.tolist() for values in rest))]


def axis_runs(skeleton: Skeleton, *, trunk_keeps: float = TRUNK_KEEPS) -> tuple[np.ndarray, ...]:
    """The same axes as flat arrays, for compiled code.

    Parameters
    ----------
    skeleton : Skeleton
    trunk_keeps : float, default 0.8

    Returns
    -------
    nodes : ndarray of shape (n_nodes,), int64
        The nodes of all axes, one axis after the other.
    first : ndarray of shape (n_axes + 1,), int64
        Axis i has the nodes ``nodes[first[i]:first[i + 1]]``.
    order, parent, attach : ndarray of shape (n_axes,), int64
        As in `Axis`.
    """
    length = skeleton.edge_length
    ahead = fill_reach(skeleton.parent, length) + length  # from a node's parent up to its tip
    start, child = child_rows(skeleton.parent)
    tree = skeleton.points, skeleton.parent, skeleton.radius, length, ahead, start, child
    return _split(tree, trunk_keeps)


@numba.njit(cache=True)
def _split(tree: tuple, trunk_keeps: float) -> tuple[np.ndarray, ...]:
    """Axes as runs of nodes: the runs, their starts, orders, parent axes and attach nodes."""
    start, child = tree[5], tree[6]
    n = len(tree[1])
    nodes, filled = np.empty(n, dtype=np.int64), 0
    first, head = np.zeros(n + 1, dtype=np.int64), np.zeros(n, dtype=np.int64)
    order, above = np.zeros(n, dtype=np.int64), np.full(n, -1, dtype=np.int64)
    attach, buffer = np.full(n, -1, dtype=np.int64), np.empty(n)
    n_axes, index = 1, 0
    while index < n_axes:
        node = head[index]
        nodes[filled] = node
        filled += 1
        while start[node] < start[node + 1]:
            heir = _heir(tree, node, buffer)
            own = nodes[first[index] : filled]
            if order[index] == 0 and not _trunk_goes_on(tree, own, heir, trunk_keeps, buffer):
                heir = -1
            for at in range(start[node], start[node + 1]):
                if child[at] != heir:
                    head[n_axes], order[n_axes] = child[at], order[index] + 1
                    above[n_axes], attach[n_axes] = index, node
                    n_axes += 1
            if heir < 0:
                break
            node = heir
            nodes[filled] = node
            filled += 1
        index += 1
        first[index] = filled
    return nodes, first[: n_axes + 1], order[:n_axes], above[:n_axes], attach[:n_axes]


@numba.njit(cache=True)
def _farthest_child(tree: tuple, node: int) -> int:
    """Child with the longest way up to a tip, -1 at a tip."""
    _, _, _, _, ahead, start, child = tree
    best = -1
    for at in range(start[node], start[node + 1]):
        if best < 0 or ahead[child[at]] > ahead[best]:
            best = child[at]
    return best


@numba.njit(cache=True)
def _place_up(tree: tuple, node: int, reach: float) -> int:
    """Node that lies `reach` up the longest way from a node."""
    travelled, length = 0.0, tree[3]
    while travelled < reach:
        following = _farthest_child(tree, node)
        if following < 0:
            break
        travelled += length[following]
        node = following
    return node


@numba.njit(cache=True)
def _place_down(tree: tuple, node: int, reach: float) -> int:
    """Node that lies `reach` down the way from a node to the root."""
    travelled, parent, length = 0.0, tree[1], tree[3]
    while travelled < reach and parent[node] >= 0:
        travelled += length[node]
        node = parent[node]
    return node


@numba.njit(cache=True)
def _straightness(tree: tuple, node: int, one: int) -> float:
    """Cosine of the turn from the stretch before a junction into one of its children."""
    points, _, radius, length, _, _, _ = tree
    reach = TURN_REACH * max(radius[node], length[node])
    down, up = _place_down(tree, node, reach), _place_up(tree, one, reach)
    before = after = both = 0.0
    for axis in range(3):
        a, b = points[node, axis] - points[down, axis], points[up, axis] - points[node, axis]
        before, after, both = before + a * a, after + b * b, both + a * b
    return both / max(np.sqrt(before * after), 1e-12)


@numba.njit(cache=True)
def _radius_ahead(tree: tuple, node: int, skip: float, stretch: float, buffer: np.ndarray) -> float:
    """Median radius over a stretch, `skip` past the fork below a node, on the longest way up."""
    _, _, radius, length, _, _, _ = tree
    travelled, n, last = length[node], 0, node
    while True:
        if travelled >= skip:
            buffer[n] = radius[last]
            n += 1
        following = _farthest_child(tree, last)
        if travelled >= skip + stretch or following < 0:
            break
        last = following
        travelled += length[last]
    return median(buffer[:n]) if n else radius[last]


@numba.njit(cache=True)
def _radius_behind(
    tree: tuple, nodes: np.ndarray, skip: float, stretch: float, buffer: np.ndarray
) -> float:
    """Median radius over a stretch, `skip` before the last of a run of nodes."""
    _, _, radius, length, _, _, _ = tree
    travelled, n = 0.0, 0
    for at in range(len(nodes) - 1, 0, -1):
        travelled += length[nodes[at]]
        if travelled > skip + stretch:
            break
        if travelled >= skip:
            buffer[n] = radius[nodes[at - 1]]
            n += 1
    if n:
        return median(buffer[:n])
    return radius[nodes[len(nodes) - 2]] if len(nodes) > 1 else radius[nodes[0]]  # one long step


@numba.njit(cache=True)
def _heir(tree: tuple, node: int, buffer: np.ndarray) -> int:
    """Child that the axis goes on into: the thickest; among similar ones far reach and straight."""
    _, _, radius, _, ahead, start, child = tree
    candidates = child[start[node] : start[node + 1]]
    if len(candidates) == 1:
        return candidates[0]
    thickness, thickest = np.empty(len(candidates)), 0.0
    for row in range(len(candidates)):
        skip = radius[node]
        thickness[row] = _radius_ahead(tree, candidates[row], skip, CHILD_STRETCH * skip, buffer)
        thickest = max(thickest, thickness[row])
    best, most = candidates[0], -np.inf
    for row in range(len(candidates)):
        if thickness[row] >= SIMILAR_RADIUS * thickest:
            straight = _straightness(tree, node, candidates[row])
            score = ahead[candidates[row]] * (STRAIGHT_BASE + straight)
            if score > most:
                best, most = candidates[row], score
    return best


@numba.njit(cache=True)
def _trunk_goes_on(
    tree: tuple, nodes: np.ndarray, heir: int, trunk_keeps: float, buffer: np.ndarray
) -> bool:
    """Whether the trunk, whose nodes so far are `nodes`, goes on into `heir`."""
    _, _, radius, _, _, start, _ = tree
    node = nodes[len(nodes) - 1]
    if start[node + 1] - start[node] == 1 or len(nodes) == 1:  # at the root there is no stem below
        return True
    diameter = 2 * radius[node]
    skip = TRUNK_SKIP * diameter
    above = _radius_ahead(tree, heir, skip, diameter, buffer)
    return above >= trunk_keeps * _radius_behind(tree, nodes, skip, diameter, buffer)


def axis_of_node(skeleton: Skeleton, axis_list: list[Axis]) -> np.ndarray:
    """Index of the axis that holds each node, (n_nodes,) int64."""
    owner = np.full(len(skeleton), -1, dtype=np.int64)
    for index, axis in enumerate(axis_list):
        owner[axis.nodes] = index
    return owner


def node_order(skeleton: Skeleton, axis_list: list[Axis]) -> np.ndarray:
    """Order of the axis that holds each node (and its edge to the parent), (n_nodes,) int64."""
    order = np.array([axis.order for axis in axis_list], dtype=np.int64)
    return order[axis_of_node(skeleton, axis_list)]


def axis_polyline(axis: Axis) -> np.ndarray:
    """Node ids of an axis from the node it hangs on (where there is one) to its tip, int64."""
    return axis.nodes if axis.attach < 0 else np.concatenate([[axis.attach], axis.nodes])
