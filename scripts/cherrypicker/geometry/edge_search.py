"""Nearest edges of a skeleton, by boxes around runs of edges (compiled).

Nodes of a skeleton follow one another along its branches, so that runs of its edges make tight
boxes without any sorting. Places are looked at along a space-filling curve: the edge that was
nearest to the last one bounds the search for the next.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from cherrypicker.compiled import compiled

__all__ = ["nearest_edges", "spatial_order"]

BITS = 10  # of a cell's number along each axis
EDGES_A_BOX = BOXES_A_BOX = 4
MOST_LEVELS = 32
TINY = 1e-24


class RootedTree(Protocol):
    """What a skeleton is here: nodes (n, 3), and the parent of each, -1 for the root."""

    points: np.ndarray
    parent: np.ndarray


def spatial_order(points: np.ndarray) -> np.ndarray:
    """Order of points along a space-filling (Morton) curve, (n_points,) int64.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    """
    return np.argsort(_cells(np.ascontiguousarray(points, dtype=np.float64)), kind="stable")


def nearest_edges(
    skeleton: RootedTree, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nearest edge of a skeleton to each place.

    Parameters
    ----------
    skeleton : Skeleton
    places : ndarray of shape (n_places, 3), float64

    Returns
    -------
    node : ndarray of shape (n_places,), int64
        Upper node of the edge.
    share : ndarray of shape (n_places,), float64
        Where on the edge: 0 at that node, 1 at its parent.
    distance : ndarray of shape (n_places,), float64
    """
    places = np.ascontiguousarray(places, dtype=np.float64)
    return _nearest(_edges(skeleton), places, spatial_order(places))


def _edges(skeleton: RootedTree) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Upper ends, ways to the lower ends and the inverse squared lengths of all edges."""
    start = skeleton.points
    step = start[np.maximum(skeleton.parent, 0)] - start
    return start, step, 1 / np.maximum(np.einsum("ij,ij->i", step, step), TINY)


@compiled
def _cells(points: np.ndarray) -> np.ndarray:
    """Number of each point's cell on a Morton curve through its cloud's bounding cube."""
    n, side = len(points), 0.0
    low, key = np.zeros(3), np.zeros(n, dtype=np.int64)
    for axis in range(3 if n else 0):
        high = low[axis] = points[0, axis]
        for row in range(n):
            low[axis], high = min(low[axis], points[row, axis]), max(high, points[row, axis])
        side = max(side, high - low[axis])
    scale = (2**BITS - 1) / max(side, TINY)
    for row in range(n):
        for axis in range(3):
            cell = int((points[row, axis] - low[axis]) * scale)
            cell = (cell | (cell << 16)) & 0x030000FF  # two empty bits after each
            cell = (cell | (cell << 8)) & 0x0300F00F
            cell = (cell | (cell << 4)) & 0x030C30C3
            cell = (cell | (cell << 2)) & 0x09249249
            key[row] |= cell << axis
    return key


@compiled
def _boxes(start: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes around runs of edges, then of boxes, low and high; first of a level."""
    n, first, n_levels = len(start), np.zeros(MOST_LEVELS, dtype=np.int64), 1
    size = -(-n // EDGES_A_BOX)
    first[1] = size
    while size > 1:
        size = -(-size // BOXES_A_BOX)
        n_levels += 1
        first[n_levels] = first[n_levels - 1] + size
    box = np.empty((first[n_levels], 6))
    for index in range(first[n_levels]):
        for axis in range(3):
            box[index, axis], box[index, axis + 3] = np.inf, -np.inf
    for edge in range(n):
        at = edge // EDGES_A_BOX
        for axis in range(3):
            a, b = start[edge, axis], start[edge, axis] + step[edge, axis]
            box[at, axis] = min(box[at, axis], a, b)
            box[at, axis + 3] = max(box[at, axis + 3], a, b)
    for level in range(1, n_levels):
        for index in range(first[level - 1], first[level]):
            at = first[level] + (index - first[level - 1]) // BOXES_A_BOX
            for axis in range(3):
                box[at, axis] = min(box[at, axis], box[index, axis])
                box[at, axis + 3] = max(box[at, axis + 3], box[index, axis + 3])
    return box, first[: n_levels + 1]


@compiled(inline="always")
def _is_beyond(box: np.ndarray, row: int, x: float, y: float, z: float, limit: float) -> bool:
    """Whether a place lies farther than `limit` outside a box."""
    u = max(box[row, 0] - x, x - box[row, 3], 0.0)
    v = max(box[row, 1] - y, y - box[row, 4], 0.0)
    w = max(box[row, 2] - z, z - box[row, 5], 0.0)
    return u * u + v * v + w * w > limit * limit


@compiled(inline="always")
def _to_edge(
    start: np.ndarray,
    step: np.ndarray,
    inverse: np.ndarray,
    edge: int,
    x: float,
    y: float,
    z: float,
) -> tuple[float, float]:
    """Squared distance of a place from an edge, and the share of it where it is nearest."""
    u, v, w = x - start[edge, 0], y - start[edge, 1], z - start[edge, 2]
    share = (u * step[edge, 0] + v * step[edge, 1] + w * step[edge, 2]) * inverse[edge]
    share = min(max(share, 0.0), 1.0)
    u, v, w = u - share * step[edge, 0], v - share * step[edge, 1], w - share * step[edge, 2]
    return u * u + v * v + w * w, share


@compiled
def _open(
    box: np.ndarray,
    first: np.ndarray,
    stack: np.ndarray,
    n_stack: int,
    level: int,
    at: int,
    x: float,
    y: float,
    z: float,
    limit: float,
) -> int:
    """Put the boxes in a box that may hold near edges on the stack; how many are there then."""
    below = first[level - 1]
    end = min(below + (at + 1) * BOXES_A_BOX, first[level])
    for row in range(below + at * BOXES_A_BOX, end):
        if not _is_beyond(box, row, x, y, z, limit):
            stack[n_stack, 0], stack[n_stack, 1] = level - 1, row - below
            n_stack += 1
    return n_stack


@compiled
def _nearest(
    edges: tuple, places: np.ndarray, order: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    start, step, inverse = edges
    n = len(places)
    node, share, distance = np.empty(n, dtype=np.int64), np.empty(n), np.empty(n)
    box, first = _boxes(start, step)
    stack = np.empty((BOXES_A_BOX * MOST_LEVELS, 2), dtype=np.int64)
    best = 0
    for place in order:
        x, y, z = places[place, 0], places[place, 1], places[place, 2]
        squared, at_best = _to_edge(start, step, inverse, best, x, y, z)
        least = np.sqrt(squared)
        stack[0, 0], stack[0, 1], n_stack = len(first) - 2, 0, 1
        while n_stack:
            n_stack -= 1
            level, at = stack[n_stack, 0], stack[n_stack, 1]
            if level:
                n_stack = _open(box, first, stack, n_stack, level, at, x, y, z, least)
                continue
            for edge in range(at * EDGES_A_BOX, min((at + 1) * EDGES_A_BOX, len(start))):
                squared, there = _to_edge(start, step, inverse, edge, x, y, z)
                if squared < least * least:
                    least, best, at_best = np.sqrt(squared), edge, there
        node[place], share[place], distance[place] = best, at_best, least
    return node, share, distance
