"""Skeletons and topologies as networkx graphs, and the GraphML of them."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING

from cherrypicker.files import atomic_path
from cherrypicker.skeleton.axes import node_order
from cherrypicker.skeleton.model import Skeleton

if TYPE_CHECKING:
    import networkx


def as_networkx(skeleton: Skeleton) -> networkx.Graph:
    """The tree of a skeleton as an undirected graph, as in skeleton.graphml.

    Nodes 0 (the root) and up have ``x y z radius label`` and the skeleton's fields, edges
    ``length`` (and ``gap``); ``root``, ``unit`` and ``frame`` are the graph's.
    """
    import networkx as nx

    columns = dict(zip("xyz", skeleton.points.T))
    columns |= {"radius": skeleton.radius, "label": skeleton.label, **skeleton.fields}
    gap = columns.pop("gap", None)
    graph = nx.Graph(root=0, unit=skeleton.unit, frame=skeleton.frame)
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    graph.add_nodes_from((node, dict(zip(columns, row))) for node, row in enumerate(rows))
    edges = {"length": skeleton.edge_length} | ({} if gap is None else {"gap": gap})
    rows = zip(*(values[1:].tolist() for values in edges.values()), strict=True)
    ways = zip(skeleton.parent[1:].tolist(), range(1, len(skeleton)), rows, strict=True)
    graph.add_edges_from((up, node, dict(zip(edges, row))) for up, node, row in ways)
    return graph


def fold(skeleton: Skeleton) -> networkx.Graph:
    """The graph without the nodes that have two edges (paper, section Graph Extraction).

    Root, junctions and tips have ``x y z kind``, edges ``length radius_start radius_end order
    path``, as in topology.graphml. A way starts with the radius of its own first node: that of a
    junction is the thicker axis's.
    """
    order, graph = node_order(skeleton), as_networkx(replace(skeleton, fields={}))
    for *ends, edge in graph.edges(data=True):
        edge["path"] = set(ends)
    for node in [node for node, degree in graph.degree if degree == 2 and node]:
        (one, way), (other, rest) = graph[node].items()
        graph.remove_node(node)
        path = way["path"] | rest["path"]
        graph.add_edge(one, other, length=way["length"] + rest["length"], path=path)
    for node, degree in graph.degree:
        kind = "root" if node == 0 else "tip" if degree == 1 else "junction"
        graph.nodes[node].clear()
        graph.nodes[node].update(zip("xyz", skeleton.points[node].tolist()), kind=kind)
    for _, _, edge in graph.edges(data=True):
        path = sorted(edge.pop("path"))  # a node's number is larger than its parent's
        first = path[0] if path[0] == 0 or order[path[1]] == order[path[0]] else path[1]
        edge |= {
            "radius_start": float(skeleton.radius[first]),
            "radius_end": float(skeleton.radius[path[-1]]),
            "order": int(order[path[-1]]),
            "path": " ".join(map(str, path)),
        }
    return graph


def _write(path: str | os.PathLike, graph: networkx.Graph) -> None:
    import networkx as nx

    graph.graph["root"] = str(graph.graph["root"])  # as the file's ids are
    with atomic_path(path) as temporary:
        nx.write_graphml_xml(graph, str(temporary), prettyprint=True, named_key_ids=True)


def write_skeleton_graphml(path: str | os.PathLike, skeleton: Skeleton) -> None:
    """Write ``skeleton.graphml``: one node a skeleton node, ids "0" (the root) and up.

    Its `fields` become further node attributes; ``gap`` becomes an edge attribute.
    """
    _write(path, as_networkx(skeleton))


def write_topology_graphml(path: str | os.PathLike, skeleton: Skeleton) -> None:
    """Write ``topology.graphml``: the skeleton, folded; node ids are its, a path is "0 1 2"."""
    _write(path, fold(skeleton))
