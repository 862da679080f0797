"""Skeletons of trees: contraction, graph, axes and the files that hold them."""

from cherrypicker.skeleton.axes import Axis, axes, axis_of_node, axis_polyline, node_order
from cherrypicker.skeleton.exports import (
    read_skeleton,
    read_topology,
    write_skeleton_graphml,
    write_skeleton_ply,
    write_skeleton_swc,
    write_topology_graphml,
)
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.skeleton.topology import Topology, TopologyEdge, fold

__all__ = [
    "Axis",
    "Skeleton",
    "Topology",
    "TopologyEdge",
    "axes",
    "axis_of_node",
    "axis_polyline",
    "fold",
    "node_order",
    "read_skeleton",
    "read_topology",
    "write_skeleton_graphml",
    "write_skeleton_ply",
    "write_skeleton_swc",
    "write_topology_graphml",
]
