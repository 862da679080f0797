"""A skeleton as places along its edges."""

from __future__ import annotations

import numpy as np

from cherrypicker.skeleton.model import Skeleton

__all__ = ["densify"]


def densify(
    skeleton: Skeleton, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sample every edge of a skeleton at most `step` apart.

    Returns
    -------
    points : ndarray of shape (n_samples, 3), float64
    node : ndarray of shape (n_samples,), int64
        The edge's upper node (the root for its own sample).
    radius : ndarray of shape (n_samples,), float64
    spacing : ndarray of shape (n_samples,), float64
        Length of skeleton that the sample stands for.
    """
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
    spacing = np.repeat(length / count, count)
    return (
        np.vstack([skeleton.points[:1], points]),
        np.concatenate([[0], node]),
        np.concatenate([skeleton.radius[:1], radius]),
        np.concatenate([[0.0], spacing]),
    )
