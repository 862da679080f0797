"""The skeleton as a rooted tree of nodes: what the graph stage makes and the traits read."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import depth_first_order
from scipy.spatial import cKDTree

from cherrypicker.geometry.tree_walks import fill_reach, sum_from_root


@dataclass
class Skeleton:
    """A rooted tree of skeleton nodes, parents before children."""

    points: np.ndarray  # (n_nodes, 3) float64: node positions in `unit`, in the frame named `frame`
    parent: np.ndarray  # (n_nodes,) int64: of smaller number than the node; -1 of node 0, the root
    radius: np.ndarray  # (n_nodes,) float64: radius of the wood around the node, in `unit`
    label: np.ndarray  # (n_nodes,) int64: class of the node (`cherrypicker.classes.Label`)
    # (n_nodes,) each: further quantities of a node. The graph stage writes ``n_points`` (int,
    # original points that its radius rests on), ``arc_deg`` (float, how much of the circumference
    # they cover), ``residual`` (float, robust spread of their distance to the fitted surface, in
    # `unit`), ``radius_error`` (float, standard error of the radius that they tell, in `unit`) and
    # ``gap`` (int, 1 where the edge to the parent bridges missing data)
    fields: dict[str, np.ndarray] = field(default_factory=dict)
    # unit, frame: as in the cloud that the skeleton was made from
    unit: str = "m"
    frame: str = "metric"

    def __post_init__(self) -> None:
        self.points = np.asarray(self.points, dtype=np.float64)
        self.parent = np.asarray(self.parent, dtype=np.int64)
        self.radius = np.asarray(self.radius, dtype=np.float64)
        self.label = np.asarray(self.label, dtype=np.int64)
        n_nodes = len(self.points)
        if self.points.shape != (n_nodes, 3) or n_nodes == 0:
            raise ValueError(f"points must have shape (n > 0, 3), got {self.points.shape}")
        for name in ("parent", "radius", "label"):
            if getattr(self, name).shape != (n_nodes,):
                raise ValueError(f"{name} must have shape ({n_nodes},)")
        ids = np.arange(n_nodes)
        if self.parent[0] != -1 or (self.parent[1:] < 0).any() or (self.parent >= ids).any():
            raise ValueError("node 0 must be the root (parent -1), parents before children")

    def __len__(self) -> int:
        return len(self.points)

    @property
    def edge_length(self) -> np.ndarray:
        """Length of each node's edge to its parent, (n_nodes,) float64, 0 for the root."""
        steps = self.points[1:] - self.points[self.parent[1:]]
        return np.append(0.0, np.linalg.norm(steps, axis=1))

    @property
    def n_children(self) -> np.ndarray:
        """Number of children of each node, (n_nodes,) int64."""
        return np.bincount(self.parent[1:], minlength=len(self))

    @property
    def degree(self) -> np.ndarray:
        """Number of edges of each node, (n_nodes,) int64."""
        return self.n_children + (self.parent >= 0)

    def children(self) -> list[np.ndarray]:
        """Children of each node: a list of n_nodes int64 arrays, in increasing order."""
        order = np.argsort(self.parent[1:], kind="stable") + 1
        return np.split(order, np.cumsum(self.n_children)[:-1])

    def distance_to_root(self) -> np.ndarray:
        """Length of the way along the skeleton from each node to the root, (n_nodes,) float64."""
        return sum_from_root(self.parent, self.edge_length)

    def reach(self) -> np.ndarray:
        """Length of the longest way from each node up to a tip, (n_nodes,) float64."""
        return fill_reach(self.parent, self.edge_length)

    def select(self, keep: np.ndarray) -> Skeleton:
        """Skeleton of the nodes in `keep` (bool mask, closed under parents), order kept."""
        keep = np.asarray(keep, dtype=bool)
        if not keep[0] or (keep[1:] & ~keep[self.parent[1:]]).any():
            raise ValueError("keep must hold the root and every kept node's parent")
        new_id = np.cumsum(keep) - 1
        parent = self.parent[keep]
        parent[1:] = new_id[parent[1:]]
        return self.take(np.flatnonzero(keep), parent)

    def take(self, rows: np.ndarray, parent: np.ndarray) -> Skeleton:
        """Skeleton of some of the nodes in a new order, with the parents that they have there."""
        fields = {name: values[rows] for name, values in self.fields.items()}
        of_nodes = {name: getattr(self, name)[rows] for name in ("points", "radius", "label")}
        return replace(self, parent=parent, fields=fields, **of_nodes)


def rooted_order(n_nodes: int, edges: np.ndarray, root: int) -> tuple[np.ndarray, np.ndarray]:
    """Order the nodes of a tree from its root, parents before children.

    Returns the old node ids, depth first (a path's nodes follow one another), and the parent of
    each node in the new order, -1 for the root, (n_nodes,) int64 each. A ValueError where the
    undirected edges (n_nodes - 1, 2) are not a tree over all nodes.
    """
    edges = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
    if len(edges) != n_nodes - 1:
        raise ValueError(f"a tree of {n_nodes} nodes has {n_nodes - 1} edges, got {len(edges)}")
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(n_nodes, n_nodes)).tocsr()
    order, predecessor = depth_first_order(graph, root, directed=False)
    if len(order) != n_nodes:
        raise ValueError(f"edges reach {len(order)} of {n_nodes} nodes from the root")
    new_id = np.empty(n_nodes, dtype=np.int64)
    new_id[order] = np.arange(n_nodes)
    parent = np.full(n_nodes, -1, dtype=np.int64)
    parent[1:] = new_id[predecessor[order[1:]]]
    return order.astype(np.int64), parent


class Samples(NamedTuple):
    """Places along the edges of a skeleton, the root first."""

    points: np.ndarray  # (n, 3) float64
    node: np.ndarray  # (n,) int64: the edge's upper node (the root for its own sample)
    radius: np.ndarray  # (n,) float64: of the wood
    length: np.ndarray  # (n,) float64: of the skeleton that the sample stands for

    def nearest(self, points: np.ndarray, reach: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
        """Distance of points (n, 3) to the nearest sample and its row; infinite beyond `reach`."""
        return cKDTree(self.points).query(points, distance_upper_bound=reach)


def densify(skeleton: Skeleton, step: float) -> Samples:
    """Sample every edge of a skeleton at most `step` apart."""
    length = skeleton.edge_length
    count = np.maximum(np.ceil(length / step).astype(int), 1)
    node = np.repeat(np.arange(len(skeleton)), count)
    start = np.repeat(np.cumsum(count) - count, count)
    share = (np.arange(len(node)) - start + 1.0) / np.repeat(count, count)
    parent = np.maximum(skeleton.parent[node], 0)  # the root's own sample stands where it does
    points = skeleton.points[parent] + share[:, None] * (
        skeleton.points[node] - skeleton.points[parent]
    )
    radius = (1 - share) * skeleton.radius[parent] + share * skeleton.radius[node]
    return Samples(points, node, radius, np.repeat(length / count, count))


def closed_radii(radius: np.ndarray, parent: np.ndarray, missing: float = 0.0) -> np.ndarray:
    """Radii with those left open (NaN) filled from the parents; `missing` where none is known."""
    radius, known = radius.copy(), radius[np.isfinite(radius)]
    for node in np.flatnonzero(~np.isfinite(radius)):
        radius[node] = radius[parent[node]] if node else np.append(known, missing)[0]
    return radius
