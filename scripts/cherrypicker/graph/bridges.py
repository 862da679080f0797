"""One bridge to each piece of a skeleton that missing data have cut off.

A piece that is cut off hangs on the tree in one place, and its broken end points there: a bridge
costs its length, the more the longer, and the turn that the piece's end would take.
"""

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.geometry.neighbors import component_links, components

__all__ = ["bridge_pieces"]

END_SPAN = 4.0  # spacings around a node that tell whether it is an end
LEAST_END = 0.45  # an end lies this far off the middle of its neighbours, over their mean distance
REACH_M = 0.3
TURN_COST_M = 0.3  # a right angle costs as much as this many metres
HEAVY_M = 0.1  # a bridge twice this long costs three times its length
SIDE_TURN = 1.0  # (1 - cosine) where no end says where a piece came from
MOST_NEIGHBORS = 24


def bridge_pieces(nodes, edges, spacing, scale=1.0):
    """Choose the bridges that join the pieces of a graph.

    Parameters
    ----------
    nodes : ndarray of shape (n_nodes, 3), float64
        Samples of the skeleton; node 0 is the root.
    edges : ndarray of shape (n_edges, 2), int64
    spacing : float
        Distance between samples.
    scale : float, default 1
        Size of the tree over that which the constants in metres are meant for.

    Returns
    -------
    bridges : ndarray of shape (n_pieces - 1, 2), int64
        With them the graph is one, and each piece has one way to the root's.
    """
    piece, n_pieces = components(len(nodes), edges)
    if n_pieces == 1:
        return np.empty((0, 2), dtype=np.int64)
    outward, is_end = _ends(nodes, piece, spacing)
    pairs, cost = _from_ends(nodes, piece, outward, is_end, scale)
    direct = component_links(nodes, edges)
    step = nodes[direct[:, 1]] - nodes[direct[:, 0]]
    direct_cost = _cost(np.linalg.norm(step, axis=1), SIDE_TURN, scale)
    pairs, cost = np.vstack([pairs, direct]), np.concatenate([cost, direct_cost])
    order = np.lexsort((pairs[:, 1], pairs[:, 0], cost))
    return _join_from_root(pairs[order], cost[order], piece, n_pieces)


def _cost(length, turn, scale):
    return length * (1 + length / (HEAVY_M * scale)) + TURN_COST_M * scale * turn


def _ends(nodes, piece, spacing):
    """Which nodes are ends of their piece, and the direction that each points to."""
    reach = END_SPAN * spacing * (1 + 1e-9)
    k = min(MOST_NEIGHBORS, len(nodes))
    distance, near = cKDTree(nodes).query(nodes, k=k, distance_upper_bound=reach)
    found = near < len(nodes)
    distance, near = np.where(found, distance, 0.0), np.where(found, near, 0)
    own = found & (piece[near] == piece[:, None])
    own[:, 0] = False
    count = own.sum(axis=1)
    middle = (nodes[near] * own[..., None]).sum(axis=1) / np.maximum(count, 1)[:, None]
    outward = np.where(count[:, None] > 0, nodes - middle, 0.0)
    mean = (distance * own).sum(axis=1) / np.maximum(count, 1)
    length = np.linalg.norm(outward, axis=1)
    is_end = (length >= LEAST_END * mean) & (count > 0)
    return outward / np.maximum(length, 1e-12)[:, None], is_end


def _from_ends(nodes, piece, outward, is_end, scale):
    """Bridges from the ends of pieces to all that lies before them, with their costs."""
    ends = np.flatnonzero(is_end)
    if not len(ends):
        return np.empty((0, 2), dtype=np.int64), np.empty(0)
    largest = np.argmax(np.bincount(piece))
    pairs = [np.empty((2, 0), dtype=np.int64)]
    for own, others in (  # the largest piece need not look for its own
        (ends[piece[ends] == largest], np.flatnonzero(piece != largest)),
        (ends[piece[ends] != largest], np.arange(len(nodes))),
    ):
        if len(own) and len(others):
            near = cKDTree(nodes[own]).sparse_distance_matrix(
                cKDTree(nodes[others]), REACH_M * scale, output_type="ndarray"
            )
            pairs.append(np.stack([own[near["i"]], others[near["j"]]]))
    start, stop = np.hstack(pairs)
    foreign = piece[start] != piece[stop]
    start, stop = start[foreign], stop[foreign]
    step = nodes[stop] - nodes[start]
    length = np.linalg.norm(step, axis=1)
    turn = 1 - np.einsum("ij,ij->i", step, outward[start]) / np.maximum(length, 1e-12)
    return np.stack([start, stop], axis=1), _cost(length, turn, scale)


def _join_from_root(pairs, cost, piece, n_pieces):
    """Cheapest bridges that join piece after piece to the root's (Prim); `cost` increases."""
    ends = piece[pairs]
    key = ends.min(axis=1) * n_pieces + ends.max(axis=1)
    _, first = np.unique(key, return_index=True)  # the cheapest between two pieces
    first.sort()
    pairs, ends = pairs[first], ends[first]
    joined = np.zeros(n_pieces, dtype=bool)
    joined[piece[0]] = True
    bridges = []
    while not joined.all():
        open_ones = np.flatnonzero(joined[ends[:, 0]] != joined[ends[:, 1]])
        best = open_ones[0]  # in order of cost
        bridges.append(pairs[best])
        joined[ends[best]] = True
    return np.array(bridges, dtype=np.int64).reshape(-1, 2)
