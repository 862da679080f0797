"""Axes of a skeleton: which child goes on at a junction, and the botanical order.

The trunk (order 0) goes on at a fork into the thickest axis while that axis, one stem diameter
above the fork, keeps at least 0.8 of the radius one diameter below it; else it ends there. Every
other axis goes on into its thickest child; the children that it leaves aside start axes of the
next order.
"""

from dataclasses import dataclass

import numpy as np

__all__ = ["Axis", "axes", "axis_of_node", "axis_polyline", "node_order"]

TRUNK_KEEPS = 0.8  # share of the radius that a trunk keeps over a fork
SIMILAR_RADIUS = 0.85  # children this close in radius are told apart by how far they reach


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


def axes(skeleton, *, trunk_keeps=TRUNK_KEEPS):
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
    tree = _Tree(skeleton)
    found = []
    waiting = [(0, 0, -1, -1)]  # first node, order, parent axis, attach node
    while waiting:
        node, order, parent_axis, attach = waiting.pop(0)
        nodes, asides = [node], []
        while len(tree.children[node]):
            heir = _heir(tree, node)
            if order == 0 and not _trunk_goes_on(tree, nodes, heir, trunk_keeps):
                asides += [(child, node) for child in tree.children[node]]
                break
            asides += [(child, node) for child in tree.children[node] if child != heir]
            node = heir
            nodes.append(node)
        index = len(found)
        found.append(Axis(np.asarray(nodes, dtype=np.int64), order, parent_axis, attach))
        waiting += [(child, order + 1, index, at) for child, at in asides]
    return found


class _Tree:
    """A skeleton with what every junction asks for, computed once."""

    def __init__(self, skeleton):
        self.radius, self.points = skeleton.radius, skeleton.points
        self.parent = skeleton.parent
        self.children = skeleton.children()
        self.length = skeleton.edge_length
        self.ahead = skeleton.reach() + self.length  # from a node's parent up to its farthest tip

    def straightness(self, node, candidates):
        """Cosine of the turn from the stretch before a junction into each child."""
        reach = max(3 * self.radius[node], 3 * self.length[node])
        before = self.points[node] - self.points[self._walk(node, reach, self._down)]
        after = np.array([self.points[self._walk(c, reach, self._up)] for c in candidates])
        after = after - self.points[node]
        norm = np.linalg.norm(before) * np.linalg.norm(after, axis=1)
        return after @ before / np.maximum(norm, 1e-12)

    def _walk(self, node, reach, step):
        travelled = 0.0
        while travelled < reach:
            following = step(node)
            if following < 0:
                break
            travelled += self.length[max(node, following)]
            node = following
        return node

    def _down(self, node):
        return self.parent[node]

    def _up(self, node):
        children = self.children[node]
        return children[np.argmax(self.ahead[children])] if len(children) else -1

    def radius_ahead(self, node, skip, window):
        """Median radius over a stretch of `window`, `skip` past the fork, on the longest way up."""
        travelled, radii = self.length[node], []
        while True:
            if travelled >= skip:
                radii.append(self.radius[node])
            if travelled >= skip + window or not len(self.children[node]):
                break
            node = self.children[node][np.argmax(self.ahead[self.children[node]])]
            travelled += self.length[node]
        return _median(radii) if radii else float(self.radius[node])

    def radius_behind(self, nodes, skip, window):
        """Median radius over a stretch of `window`, `skip` before the last of a run of nodes."""
        travelled, radii = 0.0, []
        for node, below in zip(nodes[:0:-1], nodes[-2::-1]):
            travelled += self.length[node]
            if travelled > skip + window:
                break
            if travelled >= skip:
                radii.append(self.radius[below])
        if radii:
            return _median(radii)
        return float(self.radius[nodes[-2] if len(nodes) > 1 else nodes[0]])  # one long step


def _median(values):
    """Median of a short list: NumPy's takes longer than all the rest of a junction."""
    ordered, half = sorted(values), len(values) // 2
    if len(values) % 2:
        return float(ordered[half])
    return float(ordered[half - 1] + ordered[half]) / 2


def _heir(tree, node):
    """Child that the axis goes on into: the thickest; among similar ones far reach and straight."""
    candidates = tree.children[node]
    if len(candidates) == 1:
        return candidates[0]
    skip = tree.radius[node]
    radius = np.array([tree.radius_ahead(child, skip, 2 * skip) for child in candidates])
    similar = radius >= SIMILAR_RADIUS * radius.max()
    score = tree.ahead[candidates] * (1.2 + tree.straightness(node, candidates))
    return candidates[np.argmax(np.where(similar, score, -1.0))]


def _trunk_goes_on(tree, nodes, heir, trunk_keeps):
    """Whether the trunk, whose nodes so far are `nodes`, goes on into `heir`."""
    node = nodes[-1]
    if len(tree.children[node]) == 1 or len(nodes) == 1:  # at the root there is no stem below
        return True
    diameter = 2 * tree.radius[node]
    above = tree.radius_ahead(heir, 0.5 * diameter, diameter)
    return above >= trunk_keeps * tree.radius_behind(nodes, 0.5 * diameter, diameter)


def axis_of_node(skeleton, axis_list):
    """Index of the axis that holds each node, (n_nodes,) int64."""
    owner = np.full(len(skeleton), -1, dtype=np.int64)
    for index, axis in enumerate(axis_list):
        owner[axis.nodes] = index
    return owner


def node_order(skeleton, axis_list):
    """Order of the axis that holds each node (and its edge to the parent), (n_nodes,) int64."""
    order = np.array([axis.order for axis in axis_list], dtype=np.int64)
    return order[axis_of_node(skeleton, axis_list)]


def axis_polyline(axis):
    """Node ids of an axis from the node it hangs on (where there is one) to its tip, int64."""
    return axis.nodes if axis.attach < 0 else np.concatenate([[axis.attach], axis.nodes])
