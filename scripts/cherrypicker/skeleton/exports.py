"""Skeletons and topologies from GraphML, and skeletons as PLY."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.ply import write_ply_vertices
from cherrypicker.skeleton.graphml import GraphColumns, parse_long, read_graphml
from cherrypicker.skeleton.model import Skeleton, rooted_order
from cherrypicker.skeleton.topology import Topology, TopologyEdge

__all__ = [
    "read_skeleton",
    "read_topology",
    "write_skeleton_ply",
]

LARGEST_ROUNDING = 1e-5  # float32 is enough while it moves no vertex by more than this


def _read_graph(path: str | os.PathLike) -> GraphColumns:
    """Read a GraphML tree with its `root`, as a user's error where it cannot be one."""
    if not Path(path).is_file():
        raise StageError("the graph is missing", file=path, key="skeleton.method")
    try:
        graph = read_graphml(path)
    except (SyntaxError, ValueError) as error:
        raise StageError(f"not a readable GraphML file: {error}", file=path) from error
    if str(graph.attributes.get("root")) not in graph.ids:
        raise StageError("the graph has no `root` attribute that names a node", file=path)
    strangers = {end for edge in graph.edges for end in edge} - set(graph.ids)
    if strangers:
        raise StageError(f"an edge ends at {strangers.pop()!r}, which is no node", file=path)
    return graph


def read_skeleton(path: str | os.PathLike) -> Skeleton:
    """Read ``skeleton.graphml``.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Skeleton
        Nodes keep their ids where these are already parents before children, as
        `write_skeleton_graphml` writes them.

    Raises
    ------
    StageError
        If the file is missing, unreadable, not a tree, or lacks an attribute.
    """
    graph = _read_graph(path)
    names = graph.ids
    number = {name: index for index, name in enumerate(names)}
    edges = np.array([(number[a], number[b]) for a, b in graph.edges], dtype=np.int64)
    root = number[str(graph.attributes["root"])]
    try:
        order, parent = rooted_order(len(names), edges, root)
        columns = {name: np.array(values) for name, values in graph.nodes.items()}
        points = np.stack([columns.pop(axis) for axis in "xyz"], axis=1)
        radius, label = columns.pop("radius"), columns.pop("label")
        upper = np.full(len(names), -1, dtype=np.int64)  # parents by the file's order of nodes
        upper[order[1:]] = order[parent[1:]]
        if "gap" in graph.edge_data:
            is_child = upper[edges[:, 1]] == edges[:, 0]
            columns["gap"] = np.zeros(len(names), dtype=np.int64)
            columns["gap"][np.where(is_child, edges[:, 1], edges[:, 0])] = graph.edge_data["gap"]
        if names == list(map(str, range(len(names)))) and (upper < np.arange(len(names))).all():
            order, parent = np.arange(len(names)), upper
        return Skeleton(
            points[order],
            parent,
            radius[order],
            label[order],
            {name: values[order] for name, values in columns.items()},
            graph.attributes.get("unit", "m"),
            graph.attributes.get("frame", "metric"),
        )
    except (KeyError, ValueError) as error:
        raise StageError(f"not a skeleton: {error}", file=path) from error


def read_topology(path: str | os.PathLike) -> Topology:
    """Read ``topology.graphml``.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Topology

    Raises
    ------
    StageError
        If the file is missing, unreadable or lacks an attribute.
    """
    graph = _read_graph(path)
    try:
        nodes = np.array(list(map(parse_long, graph.ids)), dtype=np.int64)
        order = np.argsort(nodes)
        points = np.array([graph.nodes[axis] for axis in "xyz"], dtype=np.float64).T[order]
        data = graph.edge_data
        edges = []
        for row, path_text in enumerate(data["path"] if graph.edges else ()):
            way = np.array(list(map(parse_long, path_text.split())), dtype=np.int64)
            if len(way) < 2:
                raise ValueError(f"the way {path_text!r} has no two nodes")
            edge = {name: data[name][row] for name in ("radius_start", "radius_end", "order")}
            length = data["length"][row]
            edges.append(TopologyEdge(int(way[0]), int(way[-1]), way, length, **edge))
        kind = [graph.nodes["kind"][row] for row in order]
    except (KeyError, ValueError) as error:
        raise StageError(f"not a topology: {error!r}", file=path) from error
    edges.sort(key=lambda edge: edge.child)
    unit = graph.attributes.get("unit", "m")
    frame = graph.attributes.get("frame", "metric")
    return Topology(nodes[order], kind, points, edges, unit, frame)


def write_skeleton_ply(path: str | os.PathLike, skeleton: Skeleton, order: np.ndarray) -> None:
    """Write ``skeleton.ply``: nodes as vertices, edges as PLY edges, binary little endian.

    Parameters
    ----------
    path : path-like
    skeleton : Skeleton
    order : ndarray of shape (n_nodes,), int
        Order of each node's axis.
    """
    small = np.abs(skeleton.points - skeleton.points.astype(np.float32)).max() <= LARGEST_ROUNDING
    columns = dict(zip("xyz", skeleton.points.astype(np.float32 if small else np.float64).T))
    columns |= {
        "radius": skeleton.radius.astype(np.float32),
        "label": skeleton.label.astype(np.uint8),
        "order": np.minimum(order, np.iinfo(np.uint8).max).astype(np.uint8),
    }
    edges = np.stack([skeleton.parent[1:], np.arange(1, len(skeleton))], axis=1)
    header = f"frame={skeleton.frame} unit={skeleton.unit}"
    with atomic_path(path) as temporary:
        write_ply_vertices(temporary, columns, [header], edges)
