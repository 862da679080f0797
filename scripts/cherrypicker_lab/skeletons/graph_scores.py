"""Contracted points, and a graph, against the true tree: nodes, edges, ways, radii."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import dijkstra

from cherrypicker.geometry.neighbors import sparse_graph
from cherrypicker.skeleton.model import densify
from cherrypicker_lab.skeletons.distances import chamfer_cm2, match_rates

CHAMFER_STEP_M = 0.005
NODE_TOLERANCE_M = 0.05
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


def score_points(points, skeleton):
    """Chamfer distance of contracted points (n, 3) to a true skeleton, as ``chamfer_cm2``."""
    return {"chamfer_cm2": chamfer_cm2(points, densify(skeleton, CHAMFER_STEP_M).points)}


def score_graph(graph, truth):
    """Compare a graph with a true tree.

    Returns ``junctions``, ``tips`` (`match_rates` at 5 cm), ``n_false_edges``, ``length_error``
    (relative, signed) and ``ways_within_10pct`` (share of all nodes).
    """
    true = graph_of(truth.skeleton)
    nodes = {
        kind: match_rates(
            graph.points[getattr(graph, kind)()],
            true.points[getattr(true, kind)()],
            NODE_TOLERANCE_M,
        )
        for kind in ("junctions", "tips")
    }
    return {
        **nodes,
        "n_false_edges": int(false_edges(graph, truth).sum()),
        "length_error": float(graph.length.sum() / true.length.sum()) - 1.0,
        "ways_within_10pct": float(ways_to_root(graph, truth).mean()),
    }


def false_edges(graph, truth):
    """Edges that do not follow the true tree, (n_edges,) bool.

    Each end stands for the places on the true tree that are at most 5 mm farther than the nearest.
    An edge leaps from one branch to another where the way along the true tree between its ends is
    longer than twice the edge plus 5 cm, whichever of those places are taken. It is off the wood
    where its middle lies farther from the true tree than 2 cm and than the wood's radius there.
    Either makes it false.
    """
    ends, inverse = np.unique(graph.edges, return_inverse=True)
    nodes = truth.candidates(graph.points[ends], SLACK_M)
    start, stop = nodes[inverse.reshape(-1, 2)].transpose(1, 0, 2)
    shortest = np.full(len(start), np.inf)
    for column in range(stop.shape[1]):
        way = truth.way(start, np.broadcast_to(stop[:, column : column + 1], start.shape))
        shortest = np.minimum(shortest, way.min(axis=1))
    leaps = shortest > DETOUR_FACTOR * graph.length + DETOUR_M
    distance, nearest = truth.tree.query(graph.points[graph.edges].mean(axis=1))
    return leaps | (distance > np.maximum(AWAY_M, truth.fine.radius[nearest]))


def ways_to_root(graph, truth):
    """Which nodes have a way to the root within 10 % of the true length, (n_nodes,) bool.

    The shortest way in the graph is compared with the true way between the places that the node and
    the graph's root stand for (up to 5 mm farther than the nearest). A node that the root does not
    reach has none.
    """
    matrix = sparse_graph(len(graph.points), graph.edges, graph.length)
    found = dijkstra(matrix, directed=False, indices=graph.root)
    nodes = truth.candidates(graph.points, SLACK_M)
    foot = np.broadcast_to(nodes[graph.root, :1], nodes.shape)
    error = np.abs(found[:, None] - truth.way(nodes, foot))
    good = (error <= WAY_TOLERANCE * truth.way(nodes, foot)).any(axis=1)
    good[graph.root] = True
    return good


def radius_errors(points, radius, truth):
    """Median error of the radius by the true one, metres, of places within 2 cm of the truth.

    The points (n, 3), with the radius found there (n,), are nodes of a skeleton, or places along
    cylinders. The errors are by `THICK_M`; what no place has is left out.
    """
    distance, nearest = truth.tree.query(points)
    near, true = distance <= AWAY_M, truth.fine.radius[nearest]
    error = radius - true
    rows = {name: near & (true >= low) & (true < high) for name, (low, high) in THICK_M.items()}
    return {name: float(np.median(error[own])) for name, own in rows.items() if own.any()}
