"""The tree solver: rooted shortest ways that would rather go straight on.

A spanning tree cuts a cycle (two branches that touch) at its longest edge, wherever that is. Here
every sample gets its cheapest way to the stem's foot over *directed* edges: a step costs its
length, more where it leaps over missing data, and a turn costs too. A branch that crosses another
so goes on through the crossing: its outer part does not turn into the other. The tree is then
collected from the farthest tip inwards; a way ends where it runs into the tree in the tree's own
direction, so that two branches can pass through the same place.
"""

import heapq
import logging

import numba
import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.geometry.neighbors import knn_edges, sparse_graph
from cherrypicker.graph.bridges import bridge_pieces
from cherrypicker.graph.line_points import ball_means
from cherrypicker.graph.samples import sample_nodes
from cherrypicker.skeleton.model import Skeleton, rooted_order
from cherrypicker.wood.gaps import STEM_GAP_M

__all__ = ["solve_tree"]

logger = logging.getLogger(__name__)

REACH_IN_SPACINGS = 3.5  # an edge this long still follows the samples of one branch
LEAP_POWER = 1.5  # a step of n spacings costs n to this power: rather many short steps
TURN_COST_M = 0.8  # a right angle costs as much as this many metres of way
FREE_TURN = 0.035  # 1 - cos of the turn that noise makes, free of charge
SAME_DIRECTION = 0.6  # cosine from which a way runs in the direction of the tree
BESIDE_IN_SPACINGS = 1.2  # skeleton points this near show that a step bridges nothing
MOST_BARE = 0.4
COVER_IN_SPACINGS = 1.5
AHEAD_IN_SPACINGS, NEAR_AHEAD, AHEAD_COSINE = 8.0, 2.0, np.cos(np.radians(20.0))
LONGEST_STEM_BRIDGE_M = STEM_GAP_M
STEM_FROM_BRANCH_M = 1.0  # what a stem that grows out of a branch costs


def solve_tree(points, labels, *, spacing_m=0.01, k=12, base=None, direction=None, seen=None):
    """Sample contracted points and connect them to a rooted tree.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Contracted points.
    labels : ndarray of shape (n_points,), int
    spacing_m : float, default 0.01
        Distance between samples.
    k : int, default 12
        Neighbours of a sample in the graph.
    base : array-like of 3 floats, optional
        Where the stem stands.
    direction : ndarray of shape (n_points, 3), optional
        Of the line that each point lies on (zeros where unknown): a branch may go straight on
        over a stretch without samples of its own, as it does next to a fork.
    seen : ndarray of shape (n_seen, 3), optional
        Points that show that a long step bridges no missing data, `points` if left out.

    Returns
    -------
    Skeleton
        With zero radii and the field ``gap``.

    Raises
    ------
    StageError
        If there are too few points or they coincide.
    """
    samples, label, spacing = sample_nodes(points, labels, spacing_m, base)
    nodes = ball_means(points, points[samples], spacing)  # contraction leaves jitter
    scale = float(np.ptp(points, axis=0).max()) / 2.5  # turns cost the same share of any tree
    edges, n_links = _candidate_edges(nodes, label, k, spacing, scale)
    if direction is not None:
        ahead = _edges_ahead(nodes, direction[samples], spacing)
        edges = np.unique(np.vstack([edges, ahead]), axis=0)
    length = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    graph = sparse_graph(len(nodes), edges, length)
    leap = graph.data
    source = np.repeat(np.arange(len(nodes)), np.diff(graph.indptr)).astype(np.int64)
    target = graph.indices.astype(np.int64)
    direction = (nodes[target] - nodes[source]) / graph.data[:, None]
    cost = leap * np.maximum(leap / spacing, 1.0) ** (LEAP_POWER - 1)
    grows_back = (label[source] != Label.TRUNK) & (label[target] == Label.TRUNK)
    cost += np.where(grows_back, STEM_FROM_BRANCH_M * scale, 0.0)
    way, before = _directed_ways(
        graph.indptr.astype(np.int64), source, target, cost, direction, TURN_COST_M * scale
    )
    ids, parent, step = _collect(nodes, source, target, direction, way, before, spacing)
    order, parent = rooted_order(
        len(ids), np.stack([parent[1:], np.arange(1, len(ids))], axis=1), 0
    )
    chosen = ids[order]
    gap = np.zeros(len(chosen), dtype=np.int64)
    steps = step[order[1:]]
    distance = np.linalg.norm(nodes[chosen[1:]] - nodes[chosen[parent[1:]]], axis=1)
    aside = np.maximum(distance - graph.data[steps], 0.0)  # a joint lies beside the step's start
    seen = points if seen is None else seen
    is_long = leap[steps] + aside > REACH_IN_SPACINGS * spacing
    ends = np.stack([parent[1:], np.arange(1, len(chosen))], axis=1)[is_long]
    bare = _bare_length(nodes[chosen], ends, distance[is_long], seen, spacing)
    gap[1:][is_long] = bare > MOST_BARE * distance[is_long]
    logger.info(
        "%d samples every %.1f mm, %d links over gaps considered, %d taken",
        len(nodes),
        1e3 * spacing,
        n_links,
        gap.sum(),
    )
    return Skeleton(nodes[chosen], parent, np.zeros(len(chosen)), label[chosen], {"gap": gap})


def _bare_length(nodes, edges, length, seen, spacing):
    """Length of each edge that no skeleton point accompanies."""
    n_steps = np.maximum(np.ceil(length / spacing).astype(np.int64), 1)
    edge = np.repeat(np.arange(len(edges)), n_steps)
    first = np.repeat(np.cumsum(n_steps) - n_steps, n_steps)
    share = (np.arange(len(edge)) - first + 0.5) / n_steps[edge]
    a, b = nodes[edges[:, 0]], nodes[edges[:, 1]]
    places = a[edge] + share[:, None] * (b - a)[edge]
    beside = BESIDE_IN_SPACINGS * spacing
    away, _ = cKDTree(seen, balanced_tree=False).query(places, distance_upper_bound=2 * beside)
    return length * np.bincount(edge, away > beside, len(edges)) / n_steps


def _candidate_edges(nodes, label, k, spacing, scale):
    """Edges between near samples, and over gaps one bridge to each piece that these leave.

    The pieces of the stem are joined to one another before anything else: branches of two whorls
    that touch would else lead around a hole in it.
    """
    edges = knn_edges(nodes, k, REACH_IN_SPACINGS * spacing)
    stem = np.flatnonzero(label == Label.TRUNK)
    links = [np.empty((0, 2), dtype=np.int64)]
    if label[0] == Label.TRUNK and len(stem) > 2:
        place = np.full(len(nodes), -1)
        place[stem] = np.arange(len(stem))
        own = place[edges]
        bridges = stem[bridge_pieces(nodes[stem], own[(own >= 0).all(axis=1)], spacing, scale)]
        length = np.linalg.norm(nodes[bridges[:, 0]] - nodes[bridges[:, 1]], axis=1)
        links.append(bridges[length <= LONGEST_STEM_BRIDGE_M * scale])
    links.append(bridge_pieces(nodes, np.vstack([edges, *links]), spacing, scale))
    links = np.unique(np.sort(np.vstack(links), axis=1), axis=0)
    return np.unique(np.vstack([edges, links]), axis=0).astype(np.int64), len(links)


def _edges_ahead(nodes, direction, spacing):
    """Edges from samples straight on along their lines, farther than to their neighbours."""
    pairs = cKDTree(nodes).query_pairs(AHEAD_IN_SPACINGS * spacing, output_type="ndarray")
    step = nodes[pairs[:, 1]] - nodes[pairs[:, 0]]
    length = np.linalg.norm(step, axis=1)
    straight = np.zeros(len(pairs), dtype=bool)
    for end in (0, 1):
        cosine = np.abs(np.einsum("ij,ij->i", step, direction[pairs[:, end]])) / length
        straight |= cosine > AHEAD_COSINE
    return pairs[straight & (length > NEAR_AHEAD * spacing)].astype(np.int64)


@numba.njit(cache=True)
def _directed_ways(indptr, source, target, cost, direction, turn_cost):
    """Cheapest way from node 0 along each directed edge, and the edge before it (Dijkstra)."""
    n_edges = len(target)
    way = np.full(n_edges, np.inf)
    before = np.full(n_edges, -1, dtype=np.int64)
    done = np.zeros(n_edges, dtype=np.bool_)
    heap = [(0.0, np.int64(-1))]
    heap.pop()
    for edge in range(indptr[0], indptr[1]):
        way[edge] = cost[edge]
        heapq.heappush(heap, (cost[edge], np.int64(edge)))
    while heap:
        so_far, edge = heapq.heappop(heap)
        if done[edge]:
            continue
        done[edge] = True
        node = target[edge]
        for following in range(indptr[node], indptr[node + 1]):
            if done[following] or target[following] == source[edge]:
                continue
            cosine = (
                direction[edge, 0] * direction[following, 0]
                + direction[edge, 1] * direction[following, 1]
                + direction[edge, 2] * direction[following, 2]
            )
            turn = max(0.0, 1.0 - cosine - FREE_TURN)
            new = so_far + cost[following] + turn_cost * turn
            if new < way[following]:
                way[following] = new
                before[following] = edge
                heapq.heappush(heap, (new, np.int64(following)))
    return way, before


def _collect(nodes, source, target, direction, way, before, spacing):
    """Collect the tree from the farthest tip inwards.

    Returns
    -------
    ids : ndarray of int64
        Sample of each tree node, the root first; a sample may appear more than once.
    parent : ndarray of int64
        Position in `ids`, -1 for the root.
    step : ndarray of int64
        Directed edge that each node is the end of, -1 for the root.
    """
    order = np.lexsort((np.arange(len(target)), way, target))
    reached, first = np.unique(target[order], return_index=True)
    best = np.full(len(nodes), -1, dtype=np.int64)
    best[reached] = order[first]
    cover = COVER_IN_SPACINGS * spacing
    pairs = cKDTree(nodes).query_pairs(cover, output_type="ndarray")
    itself = np.arange(len(nodes))
    row = np.concatenate([pairs[:, 0], pairs[:, 1], itself])
    order = np.argsort(row, kind="stable")
    start = np.searchsorted(row[order], np.arange(len(nodes) + 1))
    near = np.concatenate([pairs[:, 1], pairs[:, 0], itself])[order].astype(np.int64)
    far_first = reached[np.argsort(-way[best[reached]], kind="stable")]
    tree = _chains(nodes, target, direction, best, before, far_first, start, near)
    return tree[:, 0].copy(), tree[:, 1].copy(), tree[:, 2].copy()


@numba.njit(cache=True)
def _chains(nodes, target, direction, best, before, far_first, start, near):
    """The tree's nodes: sample, parent and edge of each; rows of `near` lie around each sample."""
    covered = np.zeros(len(nodes), dtype=np.bool_)
    # tree nodes that pass by each sample, in turn: (tree node, next of them)
    passing, n_passing = np.empty((2 * len(near), 2), dtype=np.int64), 0
    first = np.full(len(nodes), -1, dtype=np.int64)
    last = np.full(len(nodes), -1, dtype=np.int64)
    tree = np.empty((2 * len(nodes), 3), dtype=np.int64)  # sample, parent, edge
    tree[0, 0], tree[0, 1], tree[0, 2], n_tree, n_seen = 0, -1, -1, 1, 0
    chain = np.empty(len(before), dtype=np.int64)
    for turn in range(-1, len(far_first)):
        tip = far_first[turn] if turn >= 0 else 0
        if covered[tip]:
            continue
        n_chain, joint = 0, 0
        edge = best[tip] if turn >= 0 else -1
        while edge >= 0:
            joint = _joint(first, passing, direction, edge, tree, nodes, target[edge])
            if joint >= 0:
                break
            chain[n_chain] = edge
            n_chain += 1
            edge, joint = before[edge], 0
        for at in range(n_chain - 1, -1, -1):
            if n_tree == len(tree):
                tree = _doubled(tree)
            tree[n_tree, 0], tree[n_tree, 1] = target[chain[at]], joint
            tree[n_tree, 2] = chain[at]
            joint = n_tree
            n_tree += 1
        while n_seen < n_tree:
            sample = tree[n_seen, 0]
            for row in range(start[sample], start[sample + 1]):
                if n_passing == len(passing):
                    passing = _doubled(passing)
                passing[n_passing, 0], passing[n_passing, 1] = n_seen, -1
                if first[near[row]] < 0:
                    first[near[row]] = n_passing
                else:
                    passing[last[near[row]], 1] = n_passing
                last[near[row]] = n_passing
                n_passing += 1
                covered[near[row]] = True
            n_seen += 1
    return tree[:n_tree]


@numba.njit(cache=True)
def _doubled(table):
    """A table of whole numbers with as many rows again, to be filled."""
    larger = np.empty((2 * len(table), table.shape[1]), dtype=np.int64)
    for row in range(len(table)):
        for column in range(table.shape[1]):
            larger[row, column] = table[row, column]
    return larger


@numba.njit(cache=True)
def _joint(first, passing, direction, edge, tree, nodes, sample):
    """Nearest tree node around a sample that heads the same way as an edge, or -1."""
    best, nearest = -1, np.inf
    at = first[sample]
    while at >= 0:
        tree_node, at = passing[at, 0], passing[at, 1]
        if tree_node:
            cosine = 0.0
            for axis in range(3):
                cosine += direction[tree[tree_node, 2], axis] * direction[edge, axis]
            if cosine < SAME_DIRECTION:
                continue
        distance = 0.0
        for axis in range(3):
            away = nodes[tree[tree_node, 0], axis] - nodes[sample, axis]
            distance += away * away
        if distance < nearest:
            best, nearest = tree_node, distance
    return best
