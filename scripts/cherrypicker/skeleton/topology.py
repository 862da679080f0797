"""The topology graph: the skeleton with its degree-2 nodes folded away (paper, Sec. Graph)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cherrypicker.skeleton.axes import Axis, node_order
from cherrypicker.skeleton.axes import axes as find_axes
from cherrypicker.skeleton.model import Skeleton

__all__ = ["Topology", "TopologyEdge", "fold"]


@dataclass
class TopologyEdge:
    """A way between two topology nodes.

    Attributes
    ----------
    parent, child : int
        Skeleton node ids, the parent towards the root.
    path : ndarray of int64
        Skeleton node ids of the polyline, from parent to child, both included.
    length : float
        Length of the polyline in the skeleton's unit.
    radius_start, radius_end : float
        Radius where the way leaves the parent (its own first node at a junction, since the
        junction's radius is the thicker axis's) and at the child.
    order : int
        Order of the axis that the way belongs to, 0 = trunk.
    """

    parent: int
    child: int
    path: np.ndarray
    length: float
    radius_start: float
    radius_end: float
    order: int


@dataclass
class Topology:
    """Root, junctions and tips of a skeleton and the ways between them.

    Attributes
    ----------
    nodes : ndarray of int64
        Skeleton node ids, increasing; the root (0) first.
    kind : list of str
        ``root``, ``junction`` or ``tip`` per node.
    points : ndarray of shape (n, 3), float64
    edges : list of TopologyEdge
        In order of their child.
    unit, frame : str
    """

    nodes: np.ndarray
    kind: list
    points: np.ndarray
    edges: list
    unit: str = "m"
    frame: str = "metric"

    @property
    def n_junctions(self) -> int:
        """Number of junctions."""
        return self.kind.count("junction")

    @property
    def n_tips(self) -> int:
        """Number of tips."""
        return self.kind.count("tip")


def fold(skeleton: Skeleton, axis_list: list[Axis] | None = None) -> Topology:
    """Fold the degree-2 nodes of a skeleton away.

    The root always stays, whatever its degree.

    Parameters
    ----------
    skeleton : Skeleton
    axis_list : list of Axis, optional
        From `cherrypicker.skeleton.axes`, found here when left out.

    Returns
    -------
    Topology
    """
    axis_list = find_axes(skeleton) if axis_list is None else axis_list
    order = node_order(skeleton, axis_list)
    n_children = skeleton.n_children
    keep = n_children != 1
    keep[0] = True
    kept = np.flatnonzero(keep)
    kind = ["root" if node == 0 else "junction" if n_children[node] else "tip" for node in kept]
    length, edges = skeleton.edge_length, []
    for child in kept[1:]:
        way = [child, skeleton.parent[child]]
        while not keep[way[-1]]:
            way.append(skeleton.parent[way[-1]])
        path = np.array(way[::-1], dtype=np.int64)
        first = path[0] if path[0] == 0 or order[path[1]] == order[path[0]] else path[1]
        edges.append(
            TopologyEdge(
                int(path[0]),
                int(child),
                path,
                float(length[path[1:]].sum()),
                float(skeleton.radius[first]),
                float(skeleton.radius[child]),
                int(order[child]),
            )
        )
    return Topology(kept, kind, skeleton.points[kept], edges, skeleton.unit, skeleton.frame)
