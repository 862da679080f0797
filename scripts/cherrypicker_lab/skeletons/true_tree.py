"""A true skeleton prepared for comparison: ways along it, nodes near a place."""

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.skeleton.model import Skeleton, densify

STEP_M, MOST_NODES = 0.005, 16


class TrueTree:
    """A true skeleton with nodes every few millimetres and the lengths of the ways between them.

    Its attributes are `skeleton` as given, in metres, `fine` with edges split into pieces of at
    most `STEP_M`, and of the nodes of `fine` the length of the way to the root, `depth` (n_fine,),
    and a k-d `tree`.
    """

    def __init__(self, skeleton):
        self.skeleton = skeleton
        self.fine = _split(skeleton, STEP_M)
        self.depth = self.fine.distance_to_root()
        self.tree = cKDTree(self.fine.points)
        # tables of the 1st, 2nd, 4th, ... ancestors (the root is its own), and edges to the root
        self._up = [np.maximum(self.fine.parent, 0)]
        while (self._up[-1] != 0).any():
            self._up.append(self._up[-1][self._up[-1]])
        self._level = np.ones(len(self.fine), dtype=np.int64)
        self._level[0] = 0
        for up in self._up:
            self._level += self._level[up]

    def way(self, one, other):
        """Length of the way along the tree between nodes of `fine`, (n,) int each, (n,) float64."""
        one, other = np.asarray(one), np.asarray(other)
        return self.depth[one] + self.depth[other] - 2 * self.depth[self._meet(one, other)]

    def _meet(self, one, other):
        """Lowest common ancestor of pairs of nodes (binary lifting)."""
        deeper = self._level[one] >= self._level[other]
        low, high = np.where(deeper, one, other), np.where(deeper, other, one)
        lift = self._level[low] - self._level[high]
        for power, up in enumerate(self._up):
            low = np.where((lift >> power) & 1, up[low], low)
        for up in self._up[::-1]:
            apart = up[low] != up[high]
            low, high = np.where(apart, up[low], low), np.where(apart, up[high], high)
        return np.where(low == high, low, self.fine.parent[low])

    def candidates(self, points, slack):
        """Nodes of `fine` that each of places (n, 3) may stand for, (n, k) int64.

        Nodes up to `slack` farther than the nearest count: at most `MOST_NODES`, the nearest first;
        where there are fewer, the nearest again.
        """
        distance, nodes = self.tree.query(points, k=min(MOST_NODES, len(self.fine)))
        distance, nodes = distance.reshape(len(points), -1), nodes.reshape(len(points), -1)
        keep = distance <= distance[:, :1] + slack
        return np.where(keep, nodes, nodes[:, :1])


def _split(skeleton, step):
    """The same tree with edges of at most `step`."""
    places = densify(skeleton, step)
    last = np.cumsum(np.bincount(places.node)) - 1  # where each old node goes
    parent = np.arange(len(places.node)) - 1
    parent[last[:-1] + 1] = last[skeleton.parent[1:]]
    return Skeleton(places.points, parent, places.radius, skeleton.label[places.node])
