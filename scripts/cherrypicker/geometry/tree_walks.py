"""Walks along a rooted tree that is stored as parents before children."""

import numpy as np

from cherrypicker.compiled import compiled


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
def sum_from_tips(parent: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sum of a node's value and those of all nodes that hang on it, (n_nodes,) float64."""
    total = values.copy()
    for node in range(len(parent) - 1, 0, -1):
        total[parent[node]] += total[node]
    return total


@compiled
def last_common(parent: np.ndarray, node: int, other: int) -> int:
    """The last node that two nodes both hang on, or are."""
    while node != other:
        node, other = min(node, other), parent[max(node, other)]
    return node


@compiled
def window(node: int, tree: tuple, reach: float, found: np.ndarray) -> int:
    """Nodes within `reach` of a node along its path, down and up without forks.

    The tree is parents, lengths of the edges below, and only children, -1 where a node has none or
    several, (n_nodes,) each. Writes the nodes to `found` (n_nodes,) and returns their number.
    """
    parent, length, only_child = tree
    found[0], n = node, 1
    back, travelled = node, length[node]
    while parent[back] >= 0 and travelled <= reach and only_child[parent[back]] >= 0:
        back = parent[back]
        found[n] = back
        n += 1
        travelled += length[back]
    front, travelled = node, 0.0
    while only_child[front] >= 0:
        front = only_child[front]
        travelled += length[front]
        if travelled > reach:
            break
        found[n] = front
        n += 1
    return n


def chains_of(parent: np.ndarray, weight: np.ndarray) -> list[np.ndarray]:
    """Ways through a forest, heaviest first: nodes, int64, of each from its start outwards.

    Each node stands in one chain. A parent has a smaller number than its children, -1 at the roots.
    """
    # A root more, on which the roots stand, comes first
    total = sum_from_tips(np.append(-1, parent + 1), np.append(0.0, weight))[1:]
    heaviest = np.argsort(-total, kind="stable")
    heir = np.full(len(parent) + 1, -1)  # the last is that of no parent
    heir[parent[heaviest[::-1]]] = heaviest[::-1]  # the heaviest child is written last
    is_start = (parent < 0) | (heir[parent] != np.arange(len(parent)))
    chains = []
    for start in heaviest[is_start[heaviest]]:
        chain = [start]
        while heir[chain[-1]] >= 0:
            chain.append(heir[chain[-1]])
        chains.append(np.array(chain, dtype=np.int64))
    return chains
