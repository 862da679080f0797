"""Skeletons of trees as data: nodes, axes, topology, hand corrections, and the files of them.

What makes them is in `cherrypicker.contraction` and `cherrypicker.graph`; `cherrypicker.api` has it
in two calls.
"""

from cherrypicker.skeleton.axes import Axis, axes, axis_of_node, node_order
from cherrypicker.skeleton.csv_table import read_skeleton_csv
from cherrypicker.skeleton.exports import read_skeleton, write_skeleton_ply
from cherrypicker.skeleton.model import Skeleton, densify
from cherrypicker.skeleton.networks import fold, write_skeleton_graphml, write_topology_graphml

__all__ = [
    "Axis",
    "Skeleton",
    "axes",
    "axis_of_node",
    "densify",
    "fold",
    "node_order",
    "read_skeleton",
    "read_skeleton_csv",
    "write_skeleton_graphml",
    "write_skeleton_ply",
    "write_topology_graphml",
]
