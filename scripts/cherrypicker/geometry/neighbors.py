"""Neighbour graphs of point sets and the links that make them connected."""

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from cherrypicker.compiled import compiled
from cherrypicker.geometry.sampling import voxel_sample

FIRST_K = 16
CELLS_IN_GAP = 4  # cells that points are linked on, in a gap
# In local spacings: points this near touch (of the wood of eight laser scans and a tree of the
# paper's set 1.5 changes 0.5 % of the worst cloud, 3 changes 11 %)
LOCAL_REACH = 2.0
# Of the neighbour whose distance is a point's own spacing, and of the outermost point of a side:
# pairs of points do not fool it
RANK = 3


def quick_tree(points: np.ndarray) -> cKDTree:
    """A k-d tree that is built quickly and asked seldom."""
    return cKDTree(points, balanced_tree=False, compact_nodes=False)


class Cells:
    """Points (n, 3) in the cells of a grid, which are asked many times what lies around places.

    A k-d tree makes a Python list of what lies around each place.
    """

    def __init__(self, points: np.ndarray, edge: float) -> None:
        self.points, low = np.ascontiguousarray(points), points.min(axis=0)
        cell = ((points - low) / edge).astype(np.int64)
        shape = cell.max(axis=0) + 1
        key = np.ravel_multi_index(tuple(cell.T), tuple(shape))
        order = np.argsort(key, kind="stable")
        self._grid = order, key[order], shape, low, edge

    def around(self, places: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Rows of the points within the reach (m,) of any of some places (m, 3), in order."""
        found = np.zeros(len(self.points), dtype=bool)
        _mark_around(self.points, self._grid, places, reach, found)
        return np.flatnonzero(found)


@compiled
def _mark_around(
    points: np.ndarray, grid: tuple, places: np.ndarray, reach: np.ndarray, found: np.ndarray
) -> None:
    """Mark in `found` (n,) the points in reach of places; `key` is the cell of those in `order`."""
    order, key, shape, low, edge = grid
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(len(places)):
        for c in range(3):
            first[c] = max(0, int((places[k, c] - reach[k] - low[c]) / edge))
            last[c] = min(shape[c] - 1, int((places[k, c] + reach[k] - low[c]) / edge))
        for x in range(first[0], last[0] + 1):
            for y in range(first[1], last[1] + 1):
                column = (x * shape[1] + y) * shape[2]
                at = np.searchsorted(key, column + first[2])
                while at < len(key) and key[at] <= column + last[2]:
                    row, square = order[at], 0.0
                    for c in range(3):
                        square += (points[row, c] - places[k, c]) ** 2
                    found[row] |= square <= reach[k] ** 2
                    at += 1


def rows_in_box(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Rows of points (n, 3) between two corners (3,) of a box, faces included, in order."""
    inside = np.ones(len(points), dtype=bool)
    for axis in range(3):  # a whole coordinate at a time is ten times quicker than all(axis=1)
        inside &= (low[axis] <= points[:, axis]) & (points[:, axis] <= high[axis])
    return np.flatnonzero(inside)


class Neighbors:
    """The nearest points of each of some points (n, 3), asked for once for all that needs them.

    Attributes
    ----------
    distance, index : ndarray of shape (n, k + 1), float64, int64
        Nearest first, which is the point itself, or one that coincides with it; fewer where there
        are fewer points.
    """

    def __init__(self, points: np.ndarray, k: int) -> None:
        ranks = np.arange(1, max(min(k + 1, len(points)), 1) + 1)
        tree = cKDTree(points)
        # In the order of the leaves, a third quicker than in another
        found = tree.query(points[tree.indices], k=ranks)
        self.distance, self.index = map(np.empty_like, found)
        self.distance[tree.indices], self.index[tree.indices] = found

    def spacing(self, rank: int) -> float:
        """Median distance of a point to its `rank`-th nearest neighbour; 0 of fewer than two."""
        rank = min(rank, self.distance.shape[1] - 1)
        return float(np.median(self.distance[:, rank])) if rank > 0 else 0.0

    def touching(self, k: int, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Edges between neighbours that touch: as near as the points lie there.

        A laser scan is dense at the foot of a tree and sparse in its crown, dense on the side that
        it was taken from and sparse on the other. A point's local spacing is the median, over its
        `k` neighbours, of the distance to their third nearest point: a stray point takes that of
        the wood that it lies beside. Points within reach touch, and where they lie far apart those
        within `LOCAL_REACH` of their local spacings; with an infinite one all neighbours do.

        Returns
        -------
        edges : ndarray of shape (n_edges, 2), int64
            Each once, the smaller row first, sorted.
        limit : ndarray of shape (n,)
            Two points touch within the mean of theirs.
        """
        distance, neighbor = self.distance[:, : k + 1], self.index[:, : k + 1]
        k = distance.shape[1] - 1
        if k < 1:
            return np.empty((0, 2), dtype=np.int64), np.full(len(distance), reach)
        local = np.median(distance[:, min(RANK, k)][neighbor[:, 1:]], axis=1)
        limit = np.maximum(reach, LOCAL_REACH * local)
        row, column = np.nonzero(distance <= (limit[:, None] + limit[neighbor]) / 2)
        pairs = np.stack([row, neighbor[row, column]], axis=1)
        pairs = np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1)
        key = np.sort(pairs[:, 0].astype(np.int64) * len(limit) + pairs[:, 1])
        key = key[np.diff(key, prepend=-1) != 0]  # np.unique would hash them, ten times slower
        return np.stack(np.divmod(key, len(limit)), axis=1), limit


def edge_lengths(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Length of each edge (n_edges, 2) between points (n_points, 3), (n_edges,)."""
    return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)


def sparse_graph(n_nodes: int, edges: np.ndarray, weights: np.ndarray) -> csr_matrix:
    """Symmetric CSR matrix of an edge list; a weight of 0 becomes the smallest positive one."""
    weights = np.maximum(np.asarray(weights, dtype=np.float64), 1e-12)
    one_way = coo_matrix((weights, edges.T), shape=(n_nodes, n_nodes))
    return one_way + one_way.T


def components(n_nodes: int, edges: np.ndarray) -> tuple[np.ndarray, int]:
    """Component of each node, (n_nodes,) int, and the number of components."""
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(n_nodes, n_nodes))
    n_components, member = connected_components(graph, directed=False)
    return member, n_components


def by_size(member: np.ndarray) -> np.ndarray:
    """Number groups anew, 0 the largest; of equal ones the first remains the first."""
    return np.argsort(np.argsort(-np.bincount(member), kind="stable"))[member]


def edges_among(rows: np.ndarray, edges: np.ndarray, n_points: int) -> np.ndarray:
    """Edges with both ends in `rows`, renumbered, (n, 2) int64."""
    number = np.full(n_points, -1)
    number[rows] = np.arange(len(rows))
    own = number[edges]
    return own[(own >= 0).all(axis=1)]


def link_components(points: np.ndarray, gap: float) -> np.ndarray:
    """Groups of points (n, 3) that chains of steps shorter than about `gap` connect.

    Group of each point, (n,) int, 0 the largest: single linkage, on cells of a quarter of the gap,
    so that the cost does not grow with the density.
    """
    if not len(points):
        return np.zeros(0, int)
    centers, inverse, _ = voxel_sample(points, gap / CELLS_IN_GAP)
    pairs = cKDTree(centers).query_pairs(gap, output_type="ndarray")
    return by_size(components(len(centers), pairs)[0][inverse])


def component_links(
    points: np.ndarray, edges: np.ndarray, max_distance: float = np.inf
) -> np.ndarray:
    """Shortest links that join the components of a graph of points (Borůvka's rounds).

    Returns
    -------
    links : ndarray of shape (n_links, 2), int64
        With them the graph is connected, but for components farther apart than `max_distance`. They
        belong to the minimum spanning tree of the components under the distance of their nearest
        points.
    """
    tree, links = cKDTree(points), np.empty((0, 2), dtype=np.int64)
    member, n_components = components(len(points), edges)
    while n_components > 1:
        found = _nearest_foreign(points, tree, member)
        found = found[found[:, 0] <= max_distance]
        if not len(found):
            break
        pairs = np.unique(np.sort(found[:, 1:].astype(np.int64), axis=1), axis=0)
        pairs = pairs[np.argsort(edge_lengths(points, pairs), kind="stable")]
        # ties could close a cycle: the shortest ones of a tree, and of two the first
        joined, rank = np.unique(np.sort(member[pairs], axis=1), axis=0, return_index=True)
        graph = coo_matrix((rank + 1, joined.T), shape=(n_components, n_components))
        taken = np.sort(minimum_spanning_tree(graph).data.astype(np.int64)) - 1
        links = np.vstack([links, pairs[taken]])
        joined_to, n_components = components(n_components, member[pairs[taken]])
        member = joined_to[member]
    return links


def _nearest_foreign(points: np.ndarray, tree: cKDTree, member: np.ndarray) -> np.ndarray:
    """Rows (distance, point, foreign point): each small component's shortest way out."""
    asking = np.flatnonzero(member != np.argmax(np.bincount(member)))
    owner = member[asking]
    distance, neighbor = tree.query(points[asking], k=min(FIRST_K, len(points)))
    distance[member[neighbor] == owner[:, None]] = np.inf
    best = np.arange(len(asking)), np.argmin(distance, axis=1)
    table = np.column_stack([distance[best], asking, neighbor[best]])
    order = np.lexsort((*table.T[::-1], owner))
    owner, first = np.unique(owner[order], return_index=True)
    found = table[order[first]]
    for index in np.flatnonzero(~np.isfinite(found[:, 0])):  # k neighbours, all its own
        is_own = member == owner[index]
        inside, outside = np.flatnonzero(is_own), np.flatnonzero(~is_own)
        # The shortest way is no longer than that from what lies nearest to the first point
        there = outside[np.argmin(np.linalg.norm(points[outside] - points[inside[0]], axis=1))]
        reach = 1.001 * np.linalg.norm(points[inside] - points[there], axis=1).min()  # rounding
        low, high = points[inside].min(axis=0) - reach, points[inside].max(axis=0) + reach
        outside = outside[rows_in_box(points[outside], low, high)]
        distance, neighbor = cKDTree(points[outside]).query(
            points[inside], distance_upper_bound=reach
        )
        nearest = np.argmin(distance)
        found[index] = distance[nearest], inside[nearest], outside[neighbor[nearest]]
    return found
