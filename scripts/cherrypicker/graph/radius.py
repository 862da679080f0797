"""Radii of a graph that never grow from the root to a tip."""

from __future__ import annotations

import numpy as np

__all__ = ["isotonic_radii"]

UNTOLD = 1e3  # a node without an error errs by so many times the largest: it has no say


def isotonic_radii(parent: np.ndarray, radius: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Least-squares radii that are nowhere larger than their parent's.

    From the tips to the root every node pools with the child block of the largest mean for as long
    as that mean is above its own (isotonic regression on a tree, Pardalos and Xue 1999). Each
    weighs by the inverse of its variance: where a thick limb leaves a fork whose own nodes have few
    points, the limb says how thick the fork is, and a limb that is seen from one side says little.

    Parameters
    ----------
    parent : ndarray of shape (n_nodes,), int64
        Of a smaller number, -1 for the root.
    radius, error : ndarray of shape (n_nodes,), float64
        And the standard error of each, 0 where it is not known.

    Returns
    -------
    ndarray of shape (n_nodes,), float64
    """
    largest = error.max() or 1.0
    weight = (largest / np.where(error > 0, error, UNTOLD * largest)) ** 2
    mass, total, block = weight.tolist(), (weight * radius).tolist(), list(range(len(radius)))
    beyond: list[list[int]] = [[] for _ in block]  # the child blocks of each

    def mean(one: int) -> float:
        return total[one] / mass[one]

    for node in reversed(range(len(radius))):  # parents come before children
        while beyond[node]:
            best = max(beyond[node], key=mean)
            if mean(best) <= mean(node):
                break
            beyond[node].remove(best)
            beyond[node] += beyond[best]
            total[node] += total[best]
            mass[node] += mass[best]
            block[best] = node
        if node:
            beyond[parent[node]].append(node)
    for node in range(len(radius)):
        block[node] = block[block[node]]
    return np.array([mean(one) for one in block])
