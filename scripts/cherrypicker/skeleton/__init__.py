"""Skeletons of trees as data: nodes, axes, topology, hand corrections, and the files of them.

What makes them is in `cherrypicker.contraction` and `cherrypicker.graph`; `cherrypicker.api` has it
in two calls.
"""

from __future__ import annotations

import importlib
import warnings
from typing import Any

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
    "fold",
    "node_order",
    "read_skeleton",
    "read_skeleton_csv",
    "read_topology",
    "write_skeleton_graphml",
    "write_skeleton_ply",
    "write_skeleton_swc",
    "write_topology_graphml",
]


def __getattr__(name: str) -> Any:
    """Names that moved to `cherrypicker.api`, for code written before; by name, so that nobody who
    reads skeletons watches, or loads, what makes them."""
    if name in ("contract", "skeletonize"):
        text = f"cherrypicker.skeleton.{name} is cherrypicker.api.{name} now"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return getattr(importlib.import_module("cherrypicker.api"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
