"""A skeleton as places along its edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.skeleton.model import Skeleton

__all__ = ["Samples", "densify"]


class Samples(NamedTuple):
    """Places along the edges of a skeleton, the root first.

    Attributes
    ----------
    points : ndarray of shape (n, 3), float64
    node : ndarray of shape (n,), int64
        The edge's upper node (the root for its own sample).
    radius, length : ndarray of shape (n,), float64
        Of the wood; of the skeleton that the sample stands for.
    """

    points: np.ndarray
    node: np.ndarray
    radius: np.ndarray
    length: np.ndarray

    def nearest(self, points: np.ndarray, reach: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
        """Distance of points (n, 3) to the nearest sample and its row; infinite beyond `reach`."""
        return cKDTree(self.points).query(points, distance_upper_bound=reach)


def densify(skeleton: Skeleton, step: float) -> Samples:
    """Sample every edge of a skeleton at most `step` apart."""
    nodes = np.arange(1, len(skeleton))
    length = skeleton.edge_length[1:]
    count = np.maximum(np.ceil(length / step).astype(int), 1)
    node = np.repeat(nodes, count)
    start = np.repeat(np.cumsum(count) - count, count)
    share = (np.arange(len(node)) - start + 1.0) / np.repeat(count, count)
    parent = skeleton.parent[node]
    points = skeleton.points[parent] + share[:, None] * (
        skeleton.points[node] - skeleton.points[parent]
    )
    radius = (1 - share) * skeleton.radius[parent] + share * skeleton.radius[node]
    return Samples(
        np.vstack([skeleton.points[:1], points]),
        np.concatenate([[0], node]),
        np.concatenate([skeleton.radius[:1], radius]),
        np.concatenate([[0.0], np.repeat(length / count, count)]),
    )
