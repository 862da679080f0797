"""Contracted points, and a graph, against the true tree: nodes, edges, ways, axes."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from cherrypicker.geometry.neighbors import components, sparse_graph
from cherrypicker_lab.skeletons.distances import (
    chamfer_cm2,
    match_rates,
    sample_edges,
    within_rates,
)

SAMPLE_M, CHAMFER_STEP_M = 0.001, 0.005
TOLERANCES_M = (0.01, 0.02, 0.05)
NODE_TOLERANCE_M = 0.05
LEAST_AXIS_M = 0.10
AXIS_SHARE, AXIS_TOLERANCE_M = 0.7, 0.02
WAY_TOLERANCE = 0.10
SLACK_M = 0.005  # a place may stand for any wood this much farther than the nearest
DETOUR_FACTOR, DETOUR_M = 2.0, 0.05
AWAY_M = 0.02
THICK_M = {"below_4mm": (0.0, 0.004), "4_to_12mm": (0.004, 0.012), "above_12mm": (0.012, np.inf)}


@dataclass
class Graph:
    """Any undirected graph in space, a tree or not."""

    points: np.ndarray  # (n_nodes, 3) float64: metres
    edges: np.ndarray  # (n_edges, 2) int64
    root: int = 0  # node at the foot of the stem

    @property
    def degree(self):
        """Number of edges of each node, (n_nodes,) int64."""
        return np.bincount(self.edges.ravel(), minlength=len(self.points))

    @property
    def length(self):
        """Length of each edge, (n_edges,) float64."""
        return np.linalg.norm(np.diff(self.points[self.edges], axis=1)[:, 0], axis=1)

    def junctions(self):
        """Nodes with three edges and more, (n,) int64."""
        return np.flatnonzero(self.degree >= 3)

    def tips(self):
        """Nodes with one edge, without the root, (n,) int64."""
        tips = np.flatnonzero(self.degree == 1)
        return tips[tips != self.root]


def graph_of(skeleton):
    """`Graph` of a `Skeleton`."""
    child = np.arange(1, len(skeleton))
    return Graph(skeleton.points, np.stack([skeleton.parent[1:], child], axis=1), 0)


def chamfer_samples(skeleton):
    """Points every 5 mm of a true skeleton, (n, 3), each once."""
    true = graph_of(skeleton)
    truth, _, share = sample_edges(true.points, true.edges, CHAMFER_STEP_M)
    once = share > 0  # an edge's first sample is the last one of the edge below
    once[0] = True  # the root
    return truth[once]


def score_points(points, skeleton):
    """Chamfer distance of contracted points (n, 3) to a true skeleton, as ``chamfer_cm2``."""
    return {"chamfer_cm2": chamfer_cm2(points, chamfer_samples(skeleton))}


def score_graph(graph, truth):
    """Compare a graph with a true tree.

    Parameters
    ----------
    graph : Graph
    truth : TrueTree

    Returns
    -------
    dict
        ``samples`` (`within_rates` at 1, 2, 5 cm of points every millimetre), ``junctions``,
        ``tips`` (`match_rates` at 5 cm), ``n_components``, ``n_cycles``, ``false_edges``,
        ``length_m``, ``true_length_m``, ``length_error`` (relative, signed), ``ways_within_10pct``
        (share of all nodes) and ``axes`` (share of those longer than 10 cm that were found, their
        number).
    """
    true = graph_of(truth.skeleton)
    samples, _, _ = sample_edges(graph.points, graph.edges, SAMPLE_M)
    true_samples, edge, _ = sample_edges(true.points, true.edges, SAMPLE_M)
    n_components = components(len(graph.points), graph.edges)[1]
    true_length, length = float(true.length.sum()), float(graph.length.sum())
    nodes = {
        kind: match_rates(
            graph.points[getattr(graph, kind)()],
            true.points[getattr(true, kind)()],
            NODE_TOLERANCE_M,
        )
        for kind in ("junctions", "tips")
    }
    return {
        "samples": within_rates(samples, true_samples, TOLERANCES_M),
        **nodes,
        "n_components": int(n_components),
        "n_cycles": int(len(graph.edges) - len(graph.points) + n_components),
        "false_edges": false_edges(graph, truth),
        "length_m": length,
        "true_length_m": true_length,
        "length_error": length / true_length - 1.0,
        "ways_within_10pct": float(ways_to_root(graph, truth).mean()),
        "axes": axes_found(samples, true_samples, edge, truth),
    }


def false_edges(graph, truth):
    """Edges that do not follow the true tree.

    Each end stands for the places on the true tree that are at most 5 mm farther than the nearest.
    An edge is a false join where the way along the true tree between its ends is longer than twice
    the edge plus 5 cm, whichever of those places are taken: it leaps from one branch to another.
    It is off the wood where its middle lies farther from the true tree than 2 cm and than the
    wood's radius there. Either makes it false.

    Parameters
    ----------
    graph : Graph
    truth : TrueTree

    Returns
    -------
    dict
        ``n`` false edges, ``n_joins``, ``n_away``, ``share`` of all edges, ``length_m`` and
        ``length_share`` of the false ones.
    """
    ends, inverse = np.unique(graph.edges, return_inverse=True)
    nodes = truth.candidates(graph.points[ends], SLACK_M)
    start, stop = nodes[inverse.reshape(-1, 2)].transpose(1, 0, 2)
    shortest = np.full(len(start), np.inf)
    for column in range(stop.shape[1]):
        way = truth.way(start, np.broadcast_to(stop[:, column : column + 1], start.shape))
        shortest = np.minimum(shortest, way.min(axis=1))
    join = shortest > DETOUR_FACTOR * graph.length + DETOUR_M
    middle = graph.points[graph.edges].mean(axis=1)
    distance, nearest = truth.tree.query(middle)
    away = distance > np.maximum(AWAY_M, truth.fine.radius[nearest])
    false = join | away
    return {
        "n": int(false.sum()),
        "n_joins": int(join.sum()),
        "n_away": int(away.sum()),
        "share": float(false.mean()),
        "length_m": float(graph.length[false].sum()),
        "length_share": float(graph.length[false].sum() / graph.length.sum()),
    }


def ways_to_root(graph, truth):
    """Which nodes have a way to the root of about the true length.

    The shortest way in the graph is compared with the true way between the places that the node
    and the graph's root stand for (up to 5 mm farther than the nearest).

    Parameters
    ----------
    graph : Graph
    truth : TrueTree

    Returns
    -------
    ndarray of shape (n_nodes,), bool
        Within 10 % of the true length; False for nodes that the root does not reach.
    """
    matrix = sparse_graph(len(graph.points), graph.edges, graph.length)
    found = dijkstra(matrix, directed=False, indices=graph.root)
    nodes = truth.candidates(graph.points, SLACK_M)
    foot = np.broadcast_to(nodes[graph.root, :1], nodes.shape)
    error = np.abs(found[:, None] - truth.way(nodes, foot))
    good = (error <= WAY_TOLERANCE * truth.way(nodes, foot)).any(axis=1)
    good[graph.root] = True
    return good


def axes_found(samples, true_samples, edge, truth):
    """How many true axes were found, of those longer than 10 cm.

    Parameters
    ----------
    samples : ndarray of shape (n_samples, 3), float64
        Points along what was found.
    true_samples : ndarray of shape (n_true, 3), float64
        Points every millimetre of the true tree.
    edge : ndarray of shape (n_true,), int64
        Edge of the true tree that each lies on.
    truth : TrueTree

    Returns
    -------
    dict
        ``n`` and ``share_found``: those of which 70 % have a sample within 2 cm.
    """
    near = cKDTree(samples).query(true_samples, distance_upper_bound=AXIS_TOLERANCE_M)[0]
    axis_of_edge = truth.axis[1:]  # edge i ends in node i + 1
    axis, length = axis_of_edge[edge], np.bincount(axis_of_edge, graph_of(truth.skeleton).length)
    share = np.bincount(axis, np.isfinite(near)) / np.bincount(axis)
    asked = length > LEAST_AXIS_M
    n_found = int((asked & (share >= AXIS_SHARE)).sum())
    return {"n": int(asked.sum()), "share_found": n_found / max(int(asked.sum()), 1)}


def radius_errors(points, radius, truth):
    """Median error of the radius by the true one, metres, of places within 2 cm of the truth.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        Nodes of a skeleton, or places along cylinders.
    radius : ndarray of shape (n,)
        Found there.
    truth : TrueTree

    Returns
    -------
    dict of str to float
        By `THICK_M`; what no place has is left out.
    """
    distance, nearest = truth.tree.query(points)
    near, true = distance <= AWAY_M, truth.fine.radius[nearest]
    error = radius - true
    rows = {name: near & (true >= low) & (true < high) for name, (low, high) in THICK_M.items()}
    return {name: float(np.median(error[own])) for name, own in rows.items() if own.any()}
