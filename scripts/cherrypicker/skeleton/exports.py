"""Skeletons and topologies as GraphML, SWC and PLY, and back."""

from pathlib import Path

import networkx as nx
import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.skeleton.model import Skeleton, rooted_order
from cherrypicker.skeleton.topology import Topology, TopologyEdge

__all__ = [
    "read_skeleton",
    "read_topology",
    "write_skeleton_graphml",
    "write_skeleton_ply",
    "write_skeleton_swc",
    "write_topology_graphml",
]

SWC_TYPE = {1: 2}  # class trunk as SWC's axon (2), all else as dendrite (3): viewers colour by it
LARGEST_ROUNDING = 1e-5  # float32 is enough while it moves no vertex by more than this


def _write_graph(path, graph):
    """Write GraphML with the standard library's XML, so that equal graphs give equal bytes."""
    with atomic_path(path) as temporary:
        nx.write_graphml_xml(graph, str(temporary), prettyprint=True, named_key_ids=True)


def write_skeleton_graphml(path, skeleton):
    """Write ``skeleton.graphml``: one node a skeleton node, ids "0" (the root) and up.

    Parameters
    ----------
    path : path-like
    skeleton : Skeleton
        Its `fields` become further node attributes; ``gap`` becomes an edge attribute.
    """
    graph = nx.Graph(root="0", unit=skeleton.unit, frame=skeleton.frame)
    length = skeleton.edge_length
    fields = {name: values.tolist() for name, values in skeleton.fields.items() if name != "gap"}
    gap = skeleton.fields.get("gap")
    for node in range(len(skeleton)):
        x, y, z = skeleton.points[node].tolist()
        graph.add_node(
            str(node),
            x=x,
            y=y,
            z=z,
            radius=float(skeleton.radius[node]),
            label=int(skeleton.label[node]),
            **{name: values[node] for name, values in fields.items()},
        )
    for node in range(1, len(skeleton)):
        extra = {} if gap is None else {"gap": int(gap[node])}
        graph.add_edge(str(skeleton.parent[node]), str(node), length=float(length[node]), **extra)
    _write_graph(path, graph)


def write_topology_graphml(path, topology):
    """Write ``topology.graphml``; node ids are the skeleton's, a path is "0 1 2".

    Parameters
    ----------
    path : path-like
    topology : Topology
    """
    graph = nx.Graph(root="0", unit=topology.unit, frame=topology.frame)
    for node, kind, (x, y, z) in zip(
        topology.nodes.tolist(), topology.kind, topology.points.tolist()
    ):
        graph.add_node(str(node), x=x, y=y, z=z, kind=kind)
    for edge in topology.edges:
        graph.add_edge(
            str(edge.parent),
            str(edge.child),
            length=edge.length,
            radius_start=edge.radius_start,
            radius_end=edge.radius_end,
            order=edge.order,
            path=" ".join(map(str, edge.path.tolist())),
        )
    _write_graph(path, graph)


def _read_graph(path):
    """Read a GraphML tree with its `root`, as a user's error where it cannot be one."""
    if not Path(path).is_file():
        raise StageError("the graph is missing", file=path, key="graph.method")
    try:
        graph = nx.read_graphml(path)
    except (nx.NetworkXError, SyntaxError, ValueError) as error:
        raise StageError(f"not a readable GraphML file: {error}", file=path) from error
    if str(graph.graph.get("root")) not in graph:
        raise StageError("the graph has no `root` attribute that names a node", file=path)
    return graph


def read_skeleton(path):
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
    names = list(graph.nodes)
    number = {name: index for index, name in enumerate(names)}
    edges = np.array([(number[a], number[b]) for a, b in graph.edges], dtype=np.int64)
    root = number[str(graph.graph["root"])]
    try:
        order, parent = rooted_order(len(names), edges, root)
        columns = {
            key: np.array([graph.nodes[name][key] for name in names])
            for key in graph.nodes[names[root]]
        }
        points = np.stack([columns.pop(axis) for axis in "xyz"], axis=1)
        radius, label = columns.pop("radius"), columns.pop("label")
    except (KeyError, ValueError) as error:
        raise StageError(f"not a skeleton: {error}", file=path) from error
    if all("gap" in data for _, _, data in graph.edges(data=True)) and len(edges):
        columns["gap"] = np.zeros(len(names), dtype=np.int64)
        for node in range(1, len(names)):
            a, b = names[order[node]], names[order[parent[node]]]
            columns["gap"][order[node]] = graph.edges[a, b]["gap"]
    unit, frame = graph.graph.get("unit", "m"), graph.graph.get("frame", "metric")
    if root == 0 and _is_rooted(names, edges):
        order, parent = np.arange(len(names)), _parents(len(names), edges)
    return Skeleton(
        points[order],
        parent,
        radius[order],
        label[order],
        {name: values[order] for name, values in columns.items()},
        unit,
        frame,
    )


def _is_rooted(names, edges):
    """Whether ids are already 0, 1, ... with one smaller neighbour a node but the root."""
    if names != [str(index) for index in range(len(names))]:
        return False
    return len(np.unique(edges.max(axis=1))) == len(edges) if len(edges) else True


def _parents(n_nodes, edges):
    parent = np.full(n_nodes, -1, dtype=np.int64)
    if len(edges):
        parent[edges.max(axis=1)] = edges.min(axis=1)
    return parent


def read_topology(path):
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
        nodes = np.array(sorted(int(name) for name in graph.nodes), dtype=np.int64)
        data = [graph.nodes[str(node)] for node in nodes]
        points = np.array([[item[axis] for axis in "xyz"] for item in data], dtype=np.float64)
        edges = []
        for _, _, item in graph.edges(data=True):
            way = np.array([int(node) for node in item["path"].split()], dtype=np.int64)
            edges.append(
                TopologyEdge(
                    int(way[0]),
                    int(way[-1]),
                    way,
                    item["length"],
                    item["radius_start"],
                    item["radius_end"],
                    item["order"],
                )
            )
        kind = [item["kind"] for item in data]
    except (KeyError, ValueError) as error:
        raise StageError(f"not a topology: {error!r}", file=path) from error
    edges.sort(key=lambda edge: edge.child)
    unit, frame = graph.graph.get("unit", "m"), graph.graph.get("frame", "metric")
    return Topology(nodes, kind, points, edges, unit, frame)


def write_skeleton_swc(path, skeleton):
    """Write ``skeleton.swc``: id (from 1), type, x, y, z, radius, parent (-1 for the root).

    Parameters
    ----------
    path : path-like
    skeleton : Skeleton
    """
    lines = [
        f"# frame={skeleton.frame} unit={skeleton.unit}",
        "# id type x y z radius parent (type 2 = trunk, 3 = any other wood)",
    ]
    for node, ((x, y, z), radius, label, parent) in enumerate(
        zip(
            skeleton.points.tolist(),
            skeleton.radius.tolist(),
            skeleton.label.tolist(),
            skeleton.parent.tolist(),
        )
    ):
        above = parent + 1 if parent >= 0 else -1
        kind = SWC_TYPE.get(label, 3)
        lines.append(f"{node + 1} {kind} {x:.6f} {y:.6f} {z:.6f} {radius:.6f} {above}")
    with atomic_path(path) as temporary:
        Path(temporary).write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_skeleton_ply(path, skeleton, order):
    """Write ``skeleton.ply``: nodes as vertices, edges as PLY edges, binary little endian.

    Parameters
    ----------
    path : path-like
    skeleton : Skeleton
    order : ndarray of shape (n_nodes,), int
        Order of each node's axis.
    """
    small = np.abs(skeleton.points - skeleton.points.astype(np.float32)).max() <= LARGEST_ROUNDING
    real, name = ("<f4", "float") if small else ("<f8", "double")
    vertices = np.empty(
        len(skeleton),
        dtype=[("x", real), ("y", real), ("z", real), ("radius", "<f4"), ("label", "u1")]
        + [("order", "u1")],
    )
    vertices["x"], vertices["y"], vertices["z"] = skeleton.points.T
    vertices["radius"], vertices["label"] = skeleton.radius, skeleton.label
    vertices["order"] = np.minimum(order, 255)
    edges = np.stack([skeleton.parent[1:], np.arange(1, len(skeleton))], axis=1).astype("<i4")
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment frame={skeleton.frame} unit={skeleton.unit}",
        f"element vertex {len(skeleton)}",
        *(f"property {name} {axis}" for axis in "xyz"),
        "property float radius",
        "property uchar label",
        "property uchar order",
        f"element edge {len(edges)}",
        "property int vertex1",
        "property int vertex2",
        "end_header",
    ]
    with atomic_path(path) as temporary:
        payload = ("\n".join(header) + "\n").encode("ascii")
        Path(temporary).write_bytes(payload + vertices.tobytes() + edges.tobytes())
