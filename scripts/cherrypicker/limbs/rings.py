"""Rings of wood: what lies equally far from the foot, on the way over the surface.

A level set of the way over a limb's surface is a closed ring around it, whatever its thickness
(Verroust and Lazarus, "Extracting skeletal curves from 3D scattered data", 2000). Rings that follow
one another are a limb, a ring that several follow is a fork: together they are a forest, rooted at
the foot.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import triu
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from cherrypicker.geometry.neighbors import (
    Neighbors,
    component_links,
    components,
    edge_lengths,
    edges_among,
    sparse_graph,
)

N_NEIGHBORS = 6  # a mesh on a surface has six on average (Euler); more reach the next twig
REACH = 2.5  # in spacings: neighbours this near touch; where points lie far apart, in local ones
# In reaches: points of a band this near are joined by one that touches both. Eight draws of a thick
# stem with bark: 1 makes 8 to 13 limbs of 8, 1.2 makes 8 to 11, 1.4 makes 8, any 8 or 9.
REACH_OVER = 1.4
GAP_WIDTH = 1.4  # of the shortest way over a gap: ways up to this long cross it as well
FOOT_WIDTH = 2.0  # of the stem's half width at its base: what lies so near is the stem
BAND = 2.0  # in spacings: how high a ring is
# Of a band: how far a band is looked at beyond its ends. Without it a stem of 9 cm whose points are
# spread by chance falls into patches (12 limbs for 8); 0.12, 0.25 and 0.5 mend that, and find 209,
# 206 and 199 of foreign_a's 209 tips.
OVERLAP = 0.25

TURN = 5  # rings before and after a place that tell how far the way turns there
# Cosine of a turn from which wood is taken to touch only: of the chains of six clouds 0 or 1 turns
# so far where wood is whole, 1 to 4 where holes have taken the bases of limbs.
TURNED = -0.3
MOST_GAPS = 50  # of a piece beyond a turn that are compared, a ring each


@dataclass
class Ways:
    """Shortest ways over wood from the foot of the tree."""

    points: np.ndarray  # (n_points, 3) float64
    height: np.ndarray  # (n_points,) float64: of each point's way, in bands
    before: np.ndarray  # (n_points,) int64: the point before on the way, -1 at the foot
    # (n_edges, 2) int64: touching neighbours, points that one beside them joins, links of pieces
    edges: np.ndarray


@dataclass
class RingForest:
    """Rings in the order of their distance from the foot."""

    rows: list[np.ndarray]  # int64: points of each ring
    size: np.ndarray  # (n_rings,) int64: how many they are
    parent: np.ndarray  # (n_rings,) int64: the ring before, of a smaller number, -1 for none
    centre: np.ndarray  # (n_rings, 3) float64


def ways_over_wood(
    points: np.ndarray,
    near: Neighbors,
    spacing: float,
    stem: np.ndarray | None = None,
    stem_gap: float = np.inf,
) -> Ways:
    """Shortest ways over the surface from the foot of the tree.

    A step longer than the spacing costs more than it is long, so that a way follows the wood and
    does not leap to wood beside it; pieces that touch nothing are joined where they come nearest.
    Wood beyond a turn has crossed a gap as well where that is shorter.

    Points (n_points, 3) are thinned wood of one tree, z up, from the middle of the stem's lowest
    end, a spacing apart, with at least `N_NEIGHBORS` neighbours each. Where `stem`, (n_points,)
    bool, is known to be the stem, gaps up to `stem_gap` that no wood crosses cost no more than they
    are long.
    """
    touching, limit = near.touching(N_NEIGHBORS, REACH * spacing)
    edges = np.vstack([touching, _bridges(points, touching, spacing)])
    price = _price(edge_lengths(points, edges), spacing)
    if stem is not None and stem.any():
        # Over gaps between pieces of the stem that no wood joins: a board hides it there
        rows = np.flatnonzero(stem)
        piece = components(len(points), touching)[0][rows]
        order = np.argsort(piece, kind="stable")
        own = np.stack([order[:-1], order[1:]], axis=1)[np.diff(piece[order]) == 0]
        along = rows[_bridges(points[rows], own, spacing, stem_gap)]
        edges, price = np.vstack([edges, along]), np.append(price, edge_lengths(points, along))
    foot = _foot(points, edges, spacing)
    way, before, edges, price = _from_foot(points, foot, edges, price)
    ways = Ways(points, way / (BAND * spacing), before, _in_two_steps(points, edges, limit))
    forest = ring_forest(ways, np.arange(len(points)))
    over = _gaps_beyond_turns(points, spacing, way, edges, forest)
    if not len(over):
        return ways
    price = np.append(price, _price(edge_lengths(points, over), spacing))
    way, before, edges, _ = _from_foot(points, foot, np.vstack([edges, over]), price)
    return Ways(points, way / (BAND * spacing), before, _in_two_steps(points, edges, limit))


def _foot(points: np.ndarray, edges: np.ndarray, spacing: float) -> np.ndarray:
    """Points that ways start at: those of the stem up to its base.

    It is as wide there as what fills the widest angle around its middle: twigs may hang as low.
    """
    aside, rise = np.linalg.norm(points[:, :2], axis=1), points[:, 2]
    width, level = aside.min(), np.flatnonzero(np.abs(rise) <= 2 * spacing)
    if len(level):
        touching = edges[edge_lengths(points, edges) <= REACH * spacing]
        piece = components(len(level), edges_among(level, touching, len(points)))[0]
        angle = np.bincount(piece, spacing / np.maximum(aside[level], spacing))
        width = np.median(aside[level[piece == angle.argmax()]])
    foot = np.flatnonzero((rise <= 2 * spacing) & (aside <= FOOT_WIDTH * width + spacing))
    return foot if len(foot) else np.linalg.norm(points, axis=1).argmin(keepdims=True)


def _from_foot(
    points: np.ndarray, foot: np.ndarray, edges: np.ndarray, price: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The cheapest way to each point: its price, the point before; each edge once, and its price.

    A point of the foot costs as much as it lies above the lowest.
    """
    n, order = len(points), np.argsort(price, kind="stable")
    number = edges[order].min(axis=1) * n + edges[order].max(axis=1)
    number, first = np.unique(number, return_index=True)
    edges, price = np.stack(np.divmod(number, n), axis=1), price[order[first]]
    rise = points[foot, 2] - points[foot, 2].min()
    starts = np.stack([foot, np.full(len(foot), n)], axis=1)
    graph = sparse_graph(n + 1, np.vstack([edges, starts]), np.append(price, rise))
    way, before = dijkstra(graph, directed=False, indices=n, return_predecessors=True)
    before = np.where((before < 0) | (before == n), -1, before)
    return way[:-1], before[:-1].astype(np.int64), edges, price


def _price(length: np.ndarray, spacing: float) -> np.ndarray:
    """Of steps: one longer than the spacing costs more than it is long."""
    return length * np.maximum(1.0, length / spacing)


def _bridges(
    points: np.ndarray, edges: np.ndarray, spacing: float, longest: float = np.inf
) -> np.ndarray:
    """All edges over the gaps between pieces: a single one would tilt the rings beyond."""
    links = component_links(points, edges, longest)
    piece, _ = components(len(points), edges)
    rows_of = {number: np.flatnonzero(piece == number) for number in np.unique(piece[links])}
    trees = {number: cKDTree(points[rows]) for number, rows in rows_of.items()}
    found = [links]
    for a, b in links:
        one, other = sorted((piece[a], piece[b]), key=lambda number: len(rows_of[number]))
        gap = np.linalg.norm(points[a] - points[b])
        distance, nearest = trees[other].query(
            points[rows_of[one]], distance_upper_bound=GAP_WIDTH * gap + spacing
        )
        near = np.flatnonzero(np.isfinite(distance))
        found.append(np.stack([rows_of[one][near], rows_of[other][nearest[near]]], axis=1))
    return np.vstack(found)


def ring_forest(ways: Ways, rows: np.ndarray) -> RingForest:
    """Cut some of the wood into rings of equal way from the foot, and join them to a forest.

    `rows` (n,) are the points that are looked at: between others, that have their limb, they lie
    apart.
    """
    number = np.full(len(ways.points) + 1, -1)  # the last is that of no point
    number[rows] = np.arange(len(rows))
    before = number[ways.before[rows]]
    touching = edges_among(rows, ways.edges, len(ways.points))
    level, ring = _pieces_of_bands(ways.height[rows], touching)
    size = np.bincount(ring)
    centre = np.stack([np.bincount(ring, c) for c in ways.points[rows].T], axis=1) / size[:, None]
    # A ring's parent is the one from which most ways enter it; of equals the nearest to the foot
    entering = np.flatnonzero((before >= 0) & (ring[before] != ring))
    pair, votes = np.unique(
        ring[entering] * len(level) + ring[before[entering]], return_counts=True
    )
    child, up = np.divmod(pair, len(level))
    order = np.lexsort((-up, votes, child))  # the last of each child has the most votes
    parent = np.full(len(level), -1, dtype=np.int64)
    parent[child[order]] = up[order]
    # Rings that ways start in stand on the nearest such ring of the level below
    starts = np.flatnonzero((parent < 0) & (np.bincount(ring, ways.before[rows] < 0) > 0))
    for start in starts:
        below = starts[level[starts] < level[start]]
        if len(below):
            below = below[level[below] == level[below].max()]
            away = np.linalg.norm(centre[below] - centre[start], axis=1)
            parent[start] = below[np.argmin(away)]
    own = np.split(rows[np.argsort(ring, kind="stable")], np.cumsum(size)[:-1])
    return RingForest(own, size, parent, centre)


def _gaps_beyond_turns(
    points: np.ndarray, spacing: float, way: np.ndarray, edges: np.ndarray, forest: RingForest
) -> np.ndarray:
    """The gap that shortens ways the most, of each piece of wood beyond a turn, (n, 2) int64.

    Wood does not turn back on itself: where a limb's base is hidden, the only way to it over wood
    that touches may lead up another limb and down a twig of its own. What lies beyond such a turn
    may cross a gap as well, at the price that pieces pay that touch nothing.
    """
    ring = np.empty(len(points), dtype=np.int64)
    ring[np.concatenate(forest.rows)] = np.repeat(np.arange(len(forest.rows)), forest.size)
    turn = _turns(forest.parent, forest.centre)[ring]
    rest = np.flatnonzero(turn < 0)
    around = cKDTree(points[rest])
    found = [np.empty((0, 2), dtype=np.int64)]
    for number in np.unique(turn[turn >= 0]):
        rows = np.flatnonzero(turn == number)
        gap, nearest = around.query(points[rows])
        beyond = way[rest[nearest]] + _price(gap, spacing)
        gain = way[rows] - beyond
        order = np.lexsort((-gain, ring[rows]))
        starts = order[np.unique(ring[rows][order], return_index=True)[1]]
        starts = starts[np.argsort(-gain[starts], kind="stable")[:MOST_GAPS]]
        starts = starts[gain[starts] > 0]
        if not len(starts):
            continue
        own = edges_among(rows, edges, len(points))
        graph = sparse_graph(len(rows), own, _price(edge_lengths(points[rows], own), spacing))
        ways = beyond[starts, None] + dijkstra(graph, directed=False, indices=starts)
        best = starts[np.argmax(np.maximum(way[rows] - ways, 0.0).sum(axis=1))]
        near = np.linalg.norm(points[rows] - points[rows[best]], axis=1) <= gap[best]
        found.append(np.stack([rows[near], rest[nearest[near]]], axis=1))
    return np.vstack(found)


def _turns(parent: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Ring at which the way to each ring first turns back on itself, -1 where it does not."""
    up = parent
    for _ in range(TURN - 1):
        up = np.where(up >= 0, parent[up], -1)
    far = np.where(up >= 0, up[up], -1)
    one, two = centre[up] - centre[far], centre - centre[up]
    length = np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
    turned = (far >= 0) & ((one * two).sum(axis=1) < TURNED * length)
    first = np.where(turned, np.arange(len(parent)), -1)
    for ring in np.flatnonzero(parent >= 0):
        if first[parent[ring]] >= 0:
            first[ring] = first[parent[ring]]
    return first


def _in_two_steps(points: np.ndarray, edges: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """The edges, and the pairs of near points that two of them join, (n, 2) int64."""
    one = sparse_graph(len(points), edges, np.ones(len(edges)))
    pairs = np.stack(triu(one @ one, k=1).nonzero(), axis=1)
    near = edge_lengths(points, pairs) <= REACH_OVER * limit[pairs].mean(axis=1)
    return np.vstack([edges, pairs[near]])


def _pieces_of_bands(height: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Band of each connected piece of a band, from the foot on, and the piece of each point.

    A band is looked at with a part of the bands below and above it: points spread by chance leave
    gaps in a band that a way around closes (the overlapping cover of Mapper: Singh, Memoli and
    Carlsson, 2007), as a step over a point beside the band does.
    """
    n, band = len(height), np.floor(height).astype(np.int64)
    share = height - band
    beside = np.where(share < OVERLAP, band - 1, band + 1)
    nowhere = -2 - np.arange(n)
    in_the_middle = (share >= OVERLAP) & (share <= 1 - OVERLAP)
    windows = np.append(band, np.where(in_the_middle, nowhere, beside))
    links = []
    for which in np.ndindex(2, 2):
        pairs = edges + n * np.array(which)
        links.append(pairs[windows[pairs[:, 0]] == windows[pairs[:, 1]]])
    piece = components(2 * n, np.vstack(links))[0]
    _, first, ring = np.unique(2 * n * band + piece[:n], return_index=True, return_inverse=True)
    return band[first], ring
