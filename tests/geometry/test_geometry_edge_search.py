"""Nearest edges of a skeleton against looking at all of them."""

import numpy as np
import pytest

from cherrypicker.geometry.edge_search import nearest_edges, spatial_order
from cherrypicker.skeleton.model import Skeleton


def random_tree(n, rng):
    """Branches of a random walk, nodes one after the other, thick at the root."""
    parent = np.arange(-1, n - 1)
    for node in range(20, n, 20):  # every 20 nodes a new branch starts somewhere below
        parent[node] = rng.integers(0, node)
    points = np.zeros((n, 3))
    for node in range(1, n):
        points[node] = points[parent[node]] + rng.normal(0, 0.01, 3) + [0, 0, 0.005]
    return Skeleton(points, parent, np.linspace(0.05, 0.001, n), np.ones(n))


def all_distances(skeleton, places):
    """Distance of each place to each edge (to the root for edge 0), and the share along it."""
    start = skeleton.points
    step = start[np.maximum(skeleton.parent, 0)] - start
    squared = np.maximum((step**2).sum(axis=1), 1e-24)
    share = np.clip(np.einsum("pej,ej->pe", places[:, None] - start, step) / squared, 0, 1)
    foot = start + share[..., None] * step
    return np.linalg.norm(places[:, None] - foot, axis=2), share


@pytest.mark.parametrize("n", [1, 2, 4, 5, 17, 300])
def test_nearest_edge_of_all(n):
    rng = np.random.default_rng(n)
    skeleton, places = random_tree(n, rng), rng.normal(0, 0.2, (200, 3))
    node, share, distance = nearest_edges(skeleton, places)
    away, shares = all_distances(skeleton, places)
    rows = np.arange(len(places))
    np.testing.assert_allclose(distance, away.min(axis=1), atol=1e-12)
    np.testing.assert_allclose(distance, away[rows, node], atol=1e-12)
    np.testing.assert_allclose(share, shares[rows, node], atol=1e-9)


def test_spatial_order_keeps_neighbours_together():
    rng = np.random.default_rng(2)
    points = rng.uniform(-5, 3, (2000, 3))
    order = spatial_order(points)
    assert np.sort(order).tolist() == list(range(2000))
    steps = np.linalg.norm(np.diff(points[order], axis=0), axis=1)
    assert np.median(steps) < 0.2 * np.median(np.linalg.norm(np.diff(points, axis=0), axis=1))
    assert spatial_order(np.zeros((3, 3))).tolist() == [0, 1, 2]
