"""A graph of a skeleton against the true tree: nodes, edges, ways, axes."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from cherrypicker.geometry.neighbors import components, sparse_graph
from cherrypicker_lab.skeletons.distances import match_rates, sample_edges, within_rates

SAMPLE_M = 0.001
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


def score_graph(graph, truth, *, min_radius=0.0):
    """Compare a graph with a true tree.

    Parameters
    ----------
    graph : Graph
    truth : TrueTree
    min_radius : float, default 0
        Metres: only wood of this radius and more has to be found; what is found may belong to any
        wood. An axis counts up to its first thinner place, a tip where the thicker wood ends, a
        junction where three pieces of it meet.

    Returns
    -------
    dict
        ``samples`` (`within_rates` at 1, 2, 5 cm of points every millimetre), ``junctions``,
        ``tips`` (`match_rates` at 5 cm), ``n_components``, ``n_cycles``, ``false_edges``,
        ``length_m``, ``true_length_m``, ``length_error`` (relative, signed), ``ways_within_10pct``
        (share of all nodes), ``axes`` (share of those longer than 10 cm that were found, their
        number) and ``by_order``.
    """
    thick = _thick(truth.skeleton, min_radius)
    true = graph_of(truth.skeleton)
    samples, _, _ = sample_edges(graph.points, graph.edges, SAMPLE_M)
    true_samples, edge, _ = sample_edges(true.points, true.edges, SAMPLE_M)
    asked = thick[edge + 1]  # edge i ends in node i + 1
    wanted = graph_of(truth.skeleton.select(thick))
    n_components = components(len(graph.points), graph.edges)[1]
    true_length, length = float(wanted.length.sum()), float(graph.length.sum())
    return {
        "samples": within_rates(samples, true_samples, TOLERANCES_M, asked=asked),
        "junctions": _node_rates(graph, true, wanted, "junctions"),
        "tips": _node_rates(graph, true, wanted, "tips"),
        "n_components": int(n_components),
        "n_cycles": int(len(graph.edges) - len(graph.points) + n_components),
        "false_edges": false_edges(graph, truth),
        "length_m": length,
        "true_length_m": true_length,
        "length_error": length / true_length - 1.0,
        "ways_within_10pct": float(ways_to_root(graph, truth).mean()),
        "axes": _axes_summary(axes_found(samples, truth, thick)),
        "by_order": _by_order(samples, true_samples, edge, graph, truth, thick),
    }


def _thick(skeleton, min_radius):
    """Nodes that the root reaches through wood of at least `min_radius`."""
    thick = skeleton.radius >= min_radius
    thick[0] = True
    up = np.maximum(skeleton.parent, 0)
    while (thick & ~thick[up]).any():
        thick &= thick[up]
    return thick


def _node_rates(graph, true, wanted, kind):
    """`match_rates` of junctions or tips: precision against all of any wood, recall of `wanted`."""
    found = graph.points[getattr(graph, kind)()]
    everywhere = true.points[getattr(true, kind)()]
    asked = wanted.points[getattr(wanted, kind)()]
    if kind == "tips" and len(wanted.points) < len(true.points):
        # a found tip may stop anywhere on wood that is too thin to be asked for
        everywhere = np.vstack([everywhere, asked])
    rates = match_rates(found, everywhere, NODE_TOLERANCE_M)
    if len(wanted.points) == len(true.points):
        return rates
    recall = match_rates(found, asked, NODE_TOLERANCE_M)["recall"]
    precision = rates["precision"]
    f1 = 2 * precision * recall / max(precision + recall, 1e-12)
    return rates | {"recall": recall, "f1": f1, "n_true": len(asked)}


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
    nodes, _ = truth.candidates(graph.points[ends], SLACK_M)
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
    nodes, _ = truth.candidates(graph.points, SLACK_M)
    foot = np.broadcast_to(nodes[graph.root, :1], nodes.shape)
    error = np.abs(found[:, None] - truth.way(nodes, foot))
    good = (error <= WAY_TOLERANCE * truth.way(nodes, foot)).any(axis=1)
    good[graph.root] = True
    return good


def axes_found(samples, truth, thick):
    """Which true axes were found.

    Parameters
    ----------
    samples : ndarray of shape (n_samples, 3), float64
        Points along what was found.
    truth : TrueTree
    thick : ndarray of shape (n_nodes,), bool
        Nodes of the true skeleton that count.

    Returns
    -------
    length : ndarray of shape (n_axes,), float64
        Of what counts of each true axis, metres.
    share : ndarray of shape (n_axes,), float64
        Share of it with a sample within 2 cm.
    order : ndarray of shape (n_axes,), int64
    """
    true = graph_of(truth.skeleton)
    places, edge, _ = sample_edges(true.points, true.edges, SAMPLE_M)
    edge, places = edge[thick[edge + 1]], places[thick[edge + 1]]
    near = cKDTree(samples).query(places, distance_upper_bound=AXIS_TOLERANCE_M)[0]
    is_near, axis = np.isfinite(near), truth.axis[edge + 1]
    n_axes = truth.axis.max() + 1
    count = np.bincount(axis, minlength=n_axes)
    share = np.bincount(axis, is_near, minlength=n_axes) / np.maximum(count, 1)
    counted = np.where(thick[1:], true.length, 0.0)
    length = np.bincount(truth.axis[1:], counted, minlength=n_axes)
    first = np.unique(truth.axis, return_index=True)[1]
    return length, share, truth.skeleton.fields["order"][first]


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


def _axes_summary(found, chosen=True):
    length, share, _ = found
    asked = (length > LEAST_AXIS_M) & chosen
    n_found = int((asked & (share >= AXIS_SHARE)).sum())
    return {"n": int(asked.sum()), "share_found": n_found / max(int(asked.sum()), 1)}


def _by_order(samples, true_samples, edge, graph, truth, thick):
    """Per true order: length, recall at 1, 2, 5 cm, axes and tips found."""
    found_axes = axes_found(samples, truth, thick)
    distance = cKDTree(samples).query(true_samples)[0]
    order = truth.skeleton.fields["order"]
    wanted = truth.skeleton.select(thick)
    wanted_graph = graph_of(wanted)
    tips = wanted_graph.tips()
    true_length = graph_of(truth.skeleton).length
    report = {}
    for value in np.unique(order[thick]):
        rows = (order[edge + 1] == value) & thick[edge + 1]
        if not rows.any():
            continue
        tip_rows = wanted.fields["order"][tips] == value
        rates = match_rates(
            graph.points[graph.tips()], wanted.points[tips[tip_rows]], NODE_TOLERANCE_M
        )
        report[str(value)] = {
            "true_length_m": float(true_length[thick[1:] & (order[1:] == value)].sum()),
            "recall": {f"{100 * t:g}cm": float((distance[rows] <= t).mean()) for t in TOLERANCES_M},
            "axes": _axes_summary(found_axes, found_axes[2] == value),
            "tip_recall": rates["recall"],
            "n_tips": rates["n_true"],
        }
    return report
