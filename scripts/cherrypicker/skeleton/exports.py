"""Skeletons from GraphML and as PLY."""

import os
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.pointcloud import PointCloud, write_cloud
from cherrypicker.skeleton.axes import node_order
from cherrypicker.skeleton.model import Skeleton, rooted_order


def _columns(rows: list[dict]) -> dict[str, np.ndarray]:
    """Columns of the attributes that all of the rows have.

    An OverflowError where a whole number has more than 64 bits.
    """
    names = [name for name in (rows[0] if rows else ()) if all(name in row for row in rows)]
    columns = {name: [row[name] for row in rows] for name in names}
    return {
        name: np.array(values, dtype=np.int64 if type(values[0]) is int else None)
        for name, values in columns.items()
    }


def read_skeleton(path: str | os.PathLike) -> Skeleton:
    """Read ``skeleton.graphml``.

    Nodes keep their ids where these are already parents before children, as
    `write_skeleton_graphml` writes them. A `StageError` where the file is missing, unreadable, not
    a tree, or lacks an attribute.
    """
    import networkx as nx

    if not Path(path).is_file():
        raise StageError("the graph is missing", file=path, key="skeleton.method")
    try:
        graph = nx.read_graphml(path)
    except (SyntaxError, ValueError, LookupError, TypeError, nx.NetworkXException) as error:
        raise StageError(f"not a readable GraphML file: {error}", file=path) from error
    if str(graph.graph.get("root")) not in graph:
        raise StageError("the graph has no `root` attribute that names a node", file=path)
    number = {name: index for index, name in enumerate(graph)}
    edges = np.array([(number[a], number[b]) for a, b in graph.edges()], dtype=np.int64)
    try:
        order, parent = rooted_order(len(number), edges, number[str(graph.graph["root"])])
        columns = _columns([data for _, data in graph.nodes(data=True)])
        upper = np.full(len(number), -1, dtype=np.int64)  # parents by the file's order of nodes
        upper[order[1:]] = order[parent[1:]]
        of_edges = _columns([data for *_, data in graph.edges(data=True)])
        if "gap" in of_edges:
            is_child = upper[edges[:, 1]] == edges[:, 0]
            columns["gap"] = np.zeros(len(number), dtype=np.int64)
            columns["gap"][np.where(is_child, edges[:, 1], edges[:, 0])] = of_edges["gap"]
        rows = np.arange(len(number))
        if list(number) == list(map(str, rows)) and (upper < rows).all():
            order, parent = rows, upper
        columns = {name: values[order] for name, values in columns.items()}
        skeleton = Skeleton(
            np.stack([columns.pop(axis) for axis in "xyz"], axis=1),
            parent,
            columns.pop("radius"),
            columns.pop("label"),
            columns,
            graph.graph.get("unit", "m"),
            graph.graph.get("frame", "metric"),
        )
    except (KeyError, ValueError, OverflowError) as error:
        raise StageError(f"not a skeleton: {error}", file=path) from error
    if not np.isfinite(skeleton.edge_length.sum()):
        raise StageError("not a skeleton: its length is not finite", file=path)
    return skeleton


def write_skeleton_ply(path: str | os.PathLike, skeleton: Skeleton) -> None:
    """Write ``skeleton.ply``: nodes as vertices, edges as PLY edges, binary little endian."""
    fields = {
        "radius": skeleton.radius.astype(np.float32),
        "label": skeleton.label.astype(np.uint8),
        "order": np.minimum(node_order(skeleton), np.iinfo(np.uint8).max).astype(np.uint8),
    }
    nodes = PointCloud(skeleton.points, None, None, fields, skeleton.frame, skeleton.unit)
    edges = np.stack([skeleton.parent[1:], np.arange(1, len(skeleton))], axis=1)
    write_cloud(path, nodes, edges)
