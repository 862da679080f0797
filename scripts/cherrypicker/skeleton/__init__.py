"""Skeletons of trees: contraction, graph, axes and the files that hold them.

The names below are the library's stable surface; `contract` and `skeletonize` are loaded when they
are first used, since the stages that only read skeletons have no need of compiled code.
"""

from cherrypicker.skeleton.axes import Axis, axes, axis_of_node, axis_polyline, node_order
from cherrypicker.skeleton.csv_table import read_skeleton_csv
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
    "contract",
    "fold",
    "node_order",
    "read_skeleton",
    "read_skeleton_csv",
    "read_topology",
    "skeletonize",
    "write_skeleton_graphml",
    "write_skeleton_ply",
    "write_skeleton_swc",
    "write_topology_graphml",
]


def __getattr__(name):
    if name in ("contract", "skeletonize"):
        from cherrypicker.skeleton import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
