"""Axes of a skeleton: which child goes on at a junction, and the botanical order.

The trunk (order 0) goes on at a fork into the thickest axis while that axis, one stem diameter
above the fork, keeps at least 0.8 of the radius one diameter below it; else it ends there. Every
other axis goes on into its thickest child; the children that it leaves aside start axes of the
next order.
"""

from dataclasses import dataclass
from itertools import accumulate
from statistics import median

import numpy as np

from cherrypicker.skeleton.model import Skeleton

TRUNK_KEEPS = 0.8  # share of the radius that a trunk keeps over a fork (docs/lab/segmentation.md)
# Children this close in radius are told apart by how far they reach (guess). Of the length of 14
# skeletons 0.722 has the order that its generator gave it; 0.692 by the thickest child alone, 0.718
# where far and straight decide.
SIMILAR_RADIUS = 0.85
# The radii of a child are taken from one radius of the junction on, over two; those of the trunk
# from half its diameter off a fork on, over a whole one: within a fork radii are no one's own
CHILD_STRETCH, TRUNK_SKIP = 2.0, 0.5


@dataclass
class Axis:
    """One axis: a run of nodes from its base to its tip."""

    nodes: np.ndarray  # int64: from base to tip, without the one that it hangs on
    order: int  # 0 for the trunk, else the parent axis's order + 1
    parent: int  # index of the parent axis in the list, -1 for the trunk
    attach: int  # node of the parent axis that the first node hangs on, -1 for the trunk

    @property
    def way(self) -> np.ndarray:
        """Nodes from the one that it hangs on, where there is one, to its tip, int64."""
        return self.nodes if self.attach < 0 else np.append(self.attach, self.nodes)

    @property
    def wood(self) -> np.ndarray:
        """Nodes whose radii the wood has along its `way`: where it hangs on, its own first."""
        return self.nodes if self.attach < 0 else np.append(self.nodes[0], self.nodes)


def axes(skeleton: Skeleton) -> list[Axis]:
    """Split a skeleton into axes: the trunk first, parents before children, each node in one."""
    tree = _Tree(skeleton)
    found: list[Axis] = []
    waiting = [(0, 0, -1, -1)]
    for first, order, parent, attach in waiting:  # which grows by the axes that each leaves aside
        nodes = [first]
        while tree.children[nodes[-1]]:
            node = nodes[-1]
            heir = tree.heir(node)
            if order == 0 and not tree.trunk_goes_on(nodes, heir):
                heir = -1
            aside = [child for child in tree.children[node] if child != heir]
            waiting += [(child, order + 1, len(found), node) for child in aside]
            if heir < 0:
                break
            nodes.append(heir)
        found.append(Axis(np.array(nodes, dtype=np.int64), order, parent, attach))
    return found


class _Tree:
    """A skeleton as lists, and the ways along it."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.radius, self.length = skeleton.radius.tolist(), skeleton.edge_length.tolist()
        self.children = [children.tolist() for children in skeleton.children()]
        # From a node's parent up to its farthest tip, and the child on that way, -1 at a tip
        self.ahead = (skeleton.reach() + skeleton.edge_length).tolist()
        self.farthest = [
            max(children, key=self.ahead.__getitem__, default=-1) for children in self.children
        ]

    def heir(self, node: int) -> int:
        """Child that the axis goes on into: the thickest; of similar ones what reaches far."""
        candidates = self.children[node]
        if len(candidates) == 1:
            return candidates[0]
        skip = self.radius[node]
        thickness = [self.radius_ahead(one, skip, CHILD_STRETCH * skip) for one in candidates]
        least = SIMILAR_RADIUS * max(thickness)
        similar = [one for one, thick in zip(candidates, thickness, strict=True) if thick >= least]
        return max(similar, key=self.ahead.__getitem__)

    def trunk_goes_on(self, nodes: list[int], heir: int) -> bool:
        """Whether the trunk, whose nodes so far are `nodes`, goes on into `heir`."""
        node = nodes[-1]
        if len(self.children[node]) == 1:
            return True
        diameter = 2 * self.radius[node]
        skip = TRUNK_SKIP * diameter
        above = self.radius_ahead(heir, skip, diameter)
        return above >= TRUNK_KEEPS * self.radius_behind(nodes, skip, diameter)

    def radius_ahead(self, node: int, skip: float, stretch: float) -> float:
        """Median radius over a stretch, `skip` past the fork below a node, on the longest way."""
        travelled, found = self.length[node], []
        while True:
            if travelled >= skip:
                found.append(self.radius[node])
            if travelled >= skip + stretch or self.farthest[node] < 0:
                return median(found) if found else self.radius[node]
            node = self.farthest[node]
            travelled += self.length[node]

    def radius_behind(self, nodes: list[int], skip: float, stretch: float) -> float:
        """Median radius over a stretch, `skip` before the last of a run; 0 where a part lacks.

        No wood is thicker than what bears it: a ring or a thing at the stem widens its tube only.
        """
        least = list(accumulate((self.radius[node] for node in nodes), min))
        travelled, found = 0.0, []
        for node, below in zip(nodes[:0:-1], least[-2::-1], strict=True):
            travelled += self.length[node]
            if travelled > skip + stretch:
                break
            if travelled >= skip:
                found.append(below)
        if travelled < skip + stretch:
            return 0.0
        return median(found) if found else least[-2]  # one long step


def axis_of_node(skeleton: Skeleton, axis_list: list[Axis]) -> np.ndarray:
    """Index of the axis that holds each node, (n_nodes,) int64."""
    owner = np.full(len(skeleton), -1, dtype=np.int64)
    for index, axis in enumerate(axis_list):
        owner[axis.nodes] = index
    return owner


def node_order(skeleton: Skeleton) -> np.ndarray:
    """Order of the axis that holds each node (and its edge to the parent), (n_nodes,) int64."""
    axis_list = axes(skeleton)
    order = np.array([axis.order for axis in axis_list], dtype=np.int64)
    return order[axis_of_node(skeleton, axis_list)]
