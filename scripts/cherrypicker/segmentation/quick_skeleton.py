"""A quick curve skeleton of the wood of every stem, by level sets of the way from its foot.

The wood is flooded from the foot of each stem along a neighbour graph; connected pieces of equal
way from the foot are the nodes (level sets, Verroust and Lazarus 2000). Gaps that missing data
leave are bridged.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from cherrypicker.geometry.neighbors import component_links, components, knn_edges, sparse_graph
from cherrypicker.geometry.sampling import median_spacing
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.wood.feet import find_stems, stems_off_the_ground

__all__ = ["QuickSkeleton", "quick_skeletons"]

N_NEIGHBORS = 10
REACH_IN_SPACINGS = 3.5  # neighbours within this many point spacings touch each other
GAP_COST = 3.0  # a metre of missing data counts as this many of wood
LEVELS_IN_SPACINGS = 2.5  # thickness of a level set
FEWEST_NODES = 4
PIECE = 0.01  # share of all wood from which a piece has a course
COURSE = np.cos(np.radians(35.0))  # how far a piece may be off another's course
STUMP_SHARE = 0.1  # a piece that comes this low, as a share of the height, may be a stump


@dataclass
class QuickSkeleton:
    """The skeleton of one tree's wood.

    Attributes
    ----------
    skeleton : Skeleton
        Node 0 at the foot; ``radius`` is the mean distance of a node's points from it.
    rows : ndarray of int64
        Rows of the points that hang on the stem.
    level : float
        Distance between nodes.
    """

    skeleton: Skeleton
    rows: np.ndarray
    level: float


def quick_skeletons(points, ground, *, gap_m, stem_gap_m, level_m, min_points):
    """Skeletons of all trees that stand in a cloud of thinned wood.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Thinned wood, z up.
    ground : ndarray of shape (n_ground, 3)
        May be empty.
    gap_m : float
        Longest gap that is bridged in any direction.
    stem_gap_m : float
        Longest gap that is bridged along the course of a large piece.
    level_m : float
        Thickness of a level set at least.
    min_points : int
        Trees of fewer points are left out.

    Returns
    -------
    list of QuickSkeleton
        Empty where nothing looks like a stem.
    """
    spacing = median_spacing(points, cKDTree(points))
    edges = knn_edges(points, N_NEIGHBORS, REACH_IN_SPACINGS * spacing)
    links, gap_cost = _bridges(points, edges, gap_m, stem_gap_m)
    bases = find_stems(points, ground)
    way, before, owner = _flood(points, edges, links, gap_cost, bases)
    piece, _ = components(len(points), np.vstack([edges, links]))
    lost = stems_off_the_ground(points, piece, owner)
    if lost:
        bases = bases + lost
        way, before, owner = _flood(points, edges, links, gap_cost, bases)
    level = max(level_m, LEVELS_IN_SPACINGS * spacing)
    graph = np.vstack([edges, links])
    found = []
    for index in range(len(bases)):
        rows = np.flatnonzero(owner == index)
        if len(rows) >= min_points:
            skeleton = _level_skeleton(points, rows, graph, way, before, level)
            if skeleton is not None:
                found.append(QuickSkeleton(skeleton, rows, level))
    return found


def _bridges(points, edges, gap_m, stem_gap_m):
    """Links over gaps and what a metre of each costs.

    Any two pieces are linked over short gaps; a large piece is also linked from its lower end
    straight down to what it goes on from, and a stump from its upper end straight up, which is
    cheaper than a detour over a touching twig.
    """
    near = component_links(points, edges, gap_m)
    piece, _ = components(len(points), edges)
    size, tree = np.bincount(piece), cKDTree(points)
    stump_below = points[:, 2].min() + STUMP_SHARE * np.ptp(points[:, 2])
    along = [np.empty((0, 2), dtype=np.int64)]
    for index in np.flatnonzero(size >= max(PIECE * len(points), 2 * N_NEIGHBORS)):
        rows = np.flatnonzero(piece == index)
        ends = [-1.0, 1.0] if points[rows, 2].min() <= stump_below else [-1.0]
        for sense in ends:
            link = _link_on(points, tree, piece, rows, stem_gap_m, sense)
            if link is not None:
                along.append(np.array([link]))
    along = np.vstack(along)
    cost = np.concatenate([np.full(len(near), GAP_COST), np.ones(len(along))])
    return np.vstack([near, along]).astype(np.int64), cost


def _link_on(points, tree, piece, rows, gap_m, sense):
    """Link from the lower (sense -1) or upper (1) end of a piece to wood on its course, or None."""
    end = rows[np.argmax(sense * points[rows, 2])]
    near = rows[np.linalg.norm(points[rows] - points[end], axis=1) <= 0.5 * gap_m]
    middle = points[near].mean(axis=0)
    heading = np.linalg.svd(points[near] - middle, full_matrices=False)[2][0]
    heading = heading if sense * heading[2] > 0 else -heading
    ahead = (points[near] - middle) @ heading
    start = points[near[ahead >= np.quantile(ahead, 0.9)]].mean(axis=0)
    others = np.array(tree.query_ball_point(start, gap_m), dtype=np.int64)
    others = others[piece[others] != piece[end]]
    offset = points[others] - start
    others = others[offset @ heading >= COURSE * np.linalg.norm(offset, axis=1)]
    if not len(others):
        return None
    other = others[np.argmin(np.linalg.norm(points[others] - start, axis=1))]
    return near[np.argmin(np.linalg.norm(points[near] - points[other], axis=1))], other


def _foot(points, stem):
    """Rows of the wood at the foot of a stem, and the foot's place."""
    spread = np.median(np.linalg.norm(points[stem.rows, :2] - stem.base[:2], axis=1))
    near = np.linalg.norm(points[:, :2] - stem.base[:2], axis=1) <= 2.0 * spread + 0.005
    rows = np.flatnonzero(near & (points[:, 2] <= stem.base[2] + 0.5 * spread))
    if not len(rows):
        rows = stem.rows[np.argsort(points[stem.rows, 2])[:8]]
    low = np.quantile(points[rows, 2], 0.05)
    return rows, np.array([stem.base[0], stem.base[1], low])


def _flood(points, edges, links, gap_cost, bases):
    """Shortest way through the wood to each point, the point before it, and the stem it starts at.

    The way is counted from the foot of the stem; -1 for points that no way reaches.
    """
    n_points = len(points)
    if not bases:
        nothing = np.full(n_points, -1)
        return np.full(n_points, np.inf), nothing, nothing
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    gaps = gap_cost * np.linalg.norm(points[links[:, 0]] - points[links[:, 1]], axis=1)
    pairs, cost = [edges, links], [length, gaps]
    for index, stem in enumerate(bases):
        rows, foot = _foot(points, stem)
        pairs.append(np.column_stack([np.full(len(rows), n_points + index), rows]))
        cost.append(np.linalg.norm(points[rows] - foot, axis=1))
    graph = sparse_graph(
        n_points + len(bases), np.vstack(pairs).astype(np.int64), np.concatenate(cost)
    )
    way, before, owner = dijkstra(
        graph,
        directed=False,
        indices=np.arange(n_points, n_points + len(bases)),
        return_predecessors=True,
        min_only=True,
    )
    reached = np.isfinite(way[:n_points])
    return way[:n_points], before[:n_points], np.where(reached, owner[:n_points] - n_points, -1)


def _level_skeleton(points, rows, edges, way, before, level):
    """Curve skeleton of one stem's wood: a node a connected piece of a level set, or None."""
    number = np.full(len(points), -1, dtype=np.int64)
    number[rows] = np.arange(len(rows))
    step = np.floor((way[rows] - way[rows].min()) / level).astype(np.int64)
    own = number[edges]
    own = own[(own >= 0).all(axis=1)]
    own = own[step[own[:, 0]] == step[own[:, 1]]]
    foot = np.flatnonzero(step <= 0)  # pieces of the lowest level belong together: the foot
    ties = np.column_stack([np.repeat(foot[:1], max(len(foot) - 1, 0)), foot[1:]])
    graph = sparse_graph(len(rows), np.vstack([own, ties]), np.ones(len(own) + len(ties)))
    n_nodes, node = connected_components(graph, directed=False)
    if n_nodes < FEWEST_NODES or not len(foot):
        return None
    first = np.full(n_nodes, np.iinfo(np.int64).max)
    np.minimum.at(first, node, step)
    order = np.argsort(first, kind="stable")
    rank = np.empty(n_nodes, dtype=np.int64)
    rank[order] = np.arange(n_nodes)
    node = rank[node]
    count = np.bincount(node, minlength=n_nodes)
    centers = np.stack([np.bincount(node, c) / count for c in points[rows].T], axis=1)
    parent = _parents(node, before[rows], number, n_nodes)
    spread = np.bincount(node, np.linalg.norm(points[rows] - centers[node], axis=1)) / count
    skeleton = Skeleton(centers, parent, spread, np.ones(n_nodes, dtype=np.int64))
    return _prune(skeleton, level)


def _parents(node, before, number, n_nodes):
    """Parent of each node: the node that most of its points were reached from."""
    known = (before >= 0) & (before < len(number))
    origin = np.full(len(node), -1, dtype=np.int64)
    origin[known] = number[before[known]]
    rows = np.flatnonzero(origin >= 0)
    pairs = np.column_stack([node[rows], node[origin[rows]]])
    pairs = pairs[pairs[:, 0] > pairs[:, 1]]  # a lower level comes first
    pairs, votes = np.unique(pairs, axis=0, return_counts=True)
    best = np.lexsort((-votes, pairs[:, 0]))
    child, at = np.unique(pairs[best, 0], return_index=True)
    parent = np.zeros(n_nodes, dtype=np.int64)
    parent[child] = pairs[best, 1][at]
    parent[0] = -1
    return parent


def _prune(skeleton, level):
    """Without the stubs that bumps of a thick stem's surface leave in a level-set skeleton."""
    for _ in range(3):
        length, children = skeleton.edge_length, skeleton.n_children
        keep = np.ones(len(skeleton), dtype=bool)
        for tip in np.flatnonzero(children == 0):
            chain, node, travelled = [], tip, 0.0
            while node > 0 and children[node] <= 1:
                chain.append(node)
                travelled += length[node]
                node = skeleton.parent[node]
            if node > 0 and travelled < max(2.5 * level, 2.0 * skeleton.radius[node]):
                keep[chain] = False
        if keep.all():
            break
        skeleton = skeleton.select(keep)
    return skeleton
