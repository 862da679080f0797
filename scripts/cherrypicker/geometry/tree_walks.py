"""Walks along a rooted tree that is stored as parents before children (compiled)."""

from __future__ import annotations

import numpy as np

from cherrypicker.compiled import compiled

__all__ = ["child_rows", "fill_reach", "sum_from_root", "window"]


@compiled
def child_rows(parent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Children of each node as compressed rows.

    Parameters
    ----------
    parent : ndarray of shape (n_nodes,), int64
        -1 for node 0, else smaller than the node's own number.

    Returns
    -------
    start : ndarray of shape (n_nodes + 1,), int64
    child : ndarray of shape (n_nodes - 1,), int64
        The children of node i are ``child[start[i]:start[i + 1]]``, in increasing order.
    """
    n = len(parent)
    start = np.zeros(n + 1, dtype=np.int64)
    for node in range(1, n):
        start[parent[node] + 1] += 1
    for node in range(n):
        start[node + 1] += start[node]
    filled = start[:n].copy()
    child = np.empty(max(n - 1, 0), dtype=np.int64)
    for node in range(1, n):
        child[filled[parent[node]]] = node
        filled[parent[node]] += 1
    return start, child


@compiled
def fill_reach(parent: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Length of the longest way from each node up to a tip, (n_nodes,) float64."""
    reach = np.zeros(len(parent))
    for node in range(len(parent) - 1, 0, -1):
        reach[parent[node]] = max(reach[parent[node]], reach[node] + length[node])
    return reach


@compiled
def sum_from_root(parent: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sum of a node's value and those of all nodes below it, (n_nodes,) float64."""
    total = values.copy()
    for node in range(1, len(parent)):
        total[node] += total[parent[node]]
    return total


@compiled
def window(
    node: int,
    parent: np.ndarray,
    length: np.ndarray,
    start: np.ndarray,
    child: np.ndarray,
    reach: float,
    found: np.ndarray,
) -> int:
    """Nodes within `reach` of a node along its path, down and up without forks.

    Writes them to `found` (n_nodes,) and returns their number.
    """
    found[0], n = node, 1
    back, travelled = node, length[node]
    while parent[back] >= 0 and travelled <= reach:
        below = parent[back]
        if start[below + 1] - start[below] != 1:
            break
        back = below
        found[n] = back
        n += 1
        travelled += length[back]
    front, travelled = node, 0.0
    while start[front + 1] - start[front] == 1:
        front = child[start[front]]
        travelled += length[front]
        if travelled > reach:
            break
        found[n] = front
        n += 1
    return n
