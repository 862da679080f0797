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

from cherrypicker.errors import StageError
from cherrypicker.skeleton.graph import (
    FEWEST_NODES,
    auto_spacing,
    find_root,
    majority_label,
)
from cherrypicker.skeleton.model import Skeleton, rooted_order
from cherrypicker.skeleton.neighbors import component_links, components, knn_edges, sparse_graph
from cherrypicker.skeleton.sampling import farthest_point_sample

__all__ = ["solve_tree"]

logger = logging.getLogger(__name__)

REACH_IN_SPACINGS = 3.5  # an edge this long still follows the samples of one branch
NEAR_IN_SPACINGS = 2.0  # surface points this near accompany a step
LEAP_POWER = 1.5  # a step of n spacings costs n to this power: rather many short steps
TURN_COST_M = 0.8  # a right angle costs as much as this many metres of way
FREE_TURN = 0.035  # 1 - cos of the turn that noise makes, free of charge
SAME_DIRECTION = 0.6  # cosine from which a way runs in the direction of the tree
COVER_IN_SPACINGS = 1.5
GAP_CANDIDATE_M = 0.3


def solve_tree(points, labels, *, spacing_m=0.01, k=12, base=None, surface=None):
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
    surface : ndarray of shape (n_surface, 3), optional
        Points before the contraction, of a sparse and clean scan: a step between samples that
        these accompany bridges no missing data, however long it is. Among the noise of a dense
        reconstruction they prove nothing: leave them out.

    Returns
    -------
    Skeleton
        With zero radii and the field ``gap``.

    Raises
    ------
    StageError
        If there are too few points or they coincide.
    """
    spacing = auto_spacing(points, spacing_m)
    first = find_root(points, labels, base)
    samples, nearest = farthest_point_sample(points, spacing, first=first)
    if len(samples) < FEWEST_NODES:
        raise StageError(
            f"{len(samples)} skeleton samples are too few for a graph", key="graph.spacing_m"
        )
    nodes = _local_means(points, points[samples], spacing)
    label = majority_label(labels, nearest, len(nodes))
    edges, n_links = _candidate_edges(nodes, k, spacing)
    edges = edges[np.lexsort((edges[:, 1], edges[:, 0]))]
    length = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    scale = float(np.ptp(points, axis=0).max()) / 2.5  # turns cost the same share of any tree
    bare = _bare_length(nodes, edges, length, surface, spacing)
    graph = sparse_graph(len(nodes), edges, length)
    leap = sparse_graph(len(nodes), edges, bare).data
    source = np.repeat(np.arange(len(nodes)), np.diff(graph.indptr)).astype(np.int64)
    target = graph.indices.astype(np.int64)
    direction = (nodes[target] - nodes[source]) / graph.data[:, None]
    cost = leap * np.maximum(leap / spacing, 1.0) ** (LEAP_POWER - 1) + graph.data - leap
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
    gap[1:] = leap[steps] + aside > REACH_IN_SPACINGS * spacing
    logger.info(
        "%d samples every %.1f mm, %d links over gaps considered, %d taken",
        len(nodes),
        1e3 * spacing,
        n_links,
        gap.sum(),
    )
    return Skeleton(nodes[chosen], parent, np.zeros(len(chosen)), label[chosen], {"gap": gap})


def _bare_length(nodes, edges, length, surface, spacing):
    """Length of each edge that no surface point accompanies."""
    bare = length.copy()
    long_ones = np.flatnonzero(length > REACH_IN_SPACINGS * spacing)
    if surface is None or not len(long_ones):
        return bare
    n_steps = np.ceil(length[long_ones] / spacing).astype(np.int64)
    edge = np.repeat(np.arange(len(long_ones)), n_steps)
    share = (np.arange(len(edge)) - np.repeat(np.cumsum(n_steps) - n_steps, n_steps) + 0.5) / (
        n_steps[edge]
    )
    a, b = nodes[edges[long_ones, 0]], nodes[edges[long_ones, 1]]
    places = a[edge] + share[:, None] * (b - a)[edge]
    away, _ = cKDTree(surface).query(places, distance_upper_bound=2 * NEAR_IN_SPACINGS * spacing)
    alone = np.bincount(edge, away > NEAR_IN_SPACINGS * spacing) / n_steps
    bare[long_ones] *= alone
    return bare


def _local_means(points, samples, spacing):
    """Samples moved to the mean of the points within a spacing: contraction leaves jitter."""
    groups = cKDTree(points).query_ball_point(samples, spacing)
    return np.array([points[rows].mean(axis=0) for rows in groups])


def _candidate_edges(nodes, k, spacing):
    """Edges between near samples, and over gaps between the pieces that these leave."""
    edges = knn_edges(nodes, k, REACH_IN_SPACINGS * spacing)
    member, n_components = components(len(nodes), edges)
    if n_components == 1:
        return edges, 0
    links = [component_links(nodes, edges)]
    distance, neighbor = cKDTree(nodes).query(nodes, k=min(48, len(nodes)))
    foreign = (member[neighbor] != member[:, None]) & (distance <= GAP_CANDIDATE_M)
    rows = np.flatnonzero(foreign.any(axis=1))
    nearest = neighbor[rows, np.argmax(foreign[rows], axis=1)]
    links.append(np.sort(np.stack([rows, nearest], axis=1), axis=1))
    links = np.unique(np.vstack(links), axis=0)
    return np.vstack([edges, links]).astype(np.int64), len(links)


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
    near = cKDTree(nodes).query_ball_point(nodes, cover)
    covered = np.zeros(len(nodes), dtype=bool)
    passing = [[] for _ in nodes]  # tree nodes near each sample, with their directions
    ids, parent, step, heading = [0], [-1], [-1], [np.zeros(3)]
    for sample in near[0]:
        passing[sample].append(0)
        covered[sample] = True
    far_first = [node for node in reached[np.argsort(-way[best[reached]], kind="stable")]]
    for tip in far_first:
        if covered[tip]:
            continue
        chain, edge, joint = [], best[tip], 0
        while edge >= 0:
            joint = _joint(
                passing[target[edge]], direction[edge], heading, ids, nodes, target[edge]
            )
            if joint >= 0:
                break
            chain.append(edge)
            edge, joint = before[edge], 0
        for edge in reversed(chain):
            ids.append(int(target[edge]))
            parent.append(joint)
            step.append(int(edge))
            heading.append(direction[edge])
            joint = len(ids) - 1
            for sample in near[ids[-1]]:
                passing[sample].append(joint)
                covered[sample] = True
    return tuple(np.array(values, dtype=np.int64) for values in (ids, parent, step))


def _joint(candidates, direction, heading, ids, nodes, sample):
    """Nearest tree node around a sample that heads the same way, or -1."""
    best, nearest = -1, np.inf
    for tree_node in candidates:
        if tree_node and heading[tree_node] @ direction < SAME_DIRECTION:
            continue
        distance = np.linalg.norm(nodes[ids[tree_node]] - nodes[sample])
        if distance < nearest:
            best, nearest = tree_node, distance
    return best
