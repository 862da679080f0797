"""Voxel sampling, the tree's frame, graphs and the cover by spheres."""

import numpy as np
import pytest

from cherrypicker.geometry.sampling import voxel_mean, voxel_sample
from cherrypicker.segmentation.spheres import (
    cover,
    features_of,
    in_tree_frame,
    neighbor_graphs,
)


def test_voxels_average_their_points_and_count_them():
    points = np.array([[0, 0, 0], [0.01, 0, 0], [0.5, 0.5, 0.5]])
    centers, inverse, counts = voxel_sample(points, 0.1)
    assert np.allclose(centers[inverse], [[0.005, 0, 0], [0.005, 0, 0], [0.5, 0.5, 0.5]])
    assert sorted(counts) == [1, 2]
    values = voxel_mean(np.array([[0.0], [1.0], [5.0]]), inverse, counts)
    assert np.allclose(values[inverse, 0], [0.5, 0.5, 5.0])


def test_frame_puts_the_ground_at_zero_and_shrinks_tall_clouds():
    rng = np.random.default_rng(0)
    points = rng.uniform([99, 49, 3], [101, 51, 23], (20_000, 3))
    moved, shrunk = in_tree_frame(points, 4.0)
    assert shrunk == pytest.approx(0.2, rel=0.02)
    assert moved[:, 2].min() == pytest.approx(0.0, abs=0.05)
    assert np.ptp(moved[:, 2]) == pytest.approx(4.0, rel=0.02)
    assert np.abs(np.median(moved[:, :2], axis=0)).max() < 0.01
    assert in_tree_frame(points, 30.0)[1] == 1.0


def test_features_mark_missing_colour():
    points = np.ones((4, 3))
    plain = features_of(points, None, np.zeros(3), 2.0)
    assert plain.shape == (4, 10) and plain.dtype == np.float32
    assert not plain[:, :4].any()
    assert np.allclose(plain[:, 7:], 0.5)
    assert (features_of(points, np.full((4, 3), 0.5), np.zeros(3), 2.0)[:, 3] == 1).all()


def test_graphs_hold_nearest_neighbours_of_each_scale():
    points = np.random.default_rng(0).random((200, 3))
    graphs = neighbor_graphs(points, 5, 3)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    for scale, graph in enumerate(graphs):
        among = distance[:, : 200 // 4**scale]
        assert graph.shape == (200, 5) and graph.max() < among.shape[1]
        expected = np.sort(among, axis=1)[:, :5]
        assert np.allclose(np.take_along_axis(distance, graph, axis=1), expected)


def test_graphs_of_few_points_are_filled_up():
    graphs = neighbor_graphs(np.random.default_rng(0).random((3, 3)), 8, 3)
    assert all(graph.shape == (3, 8) and graph.max() < 3 for graph in graphs)


@pytest.mark.parametrize("min_visits", [1, 2])
def test_cover_reaches_every_point_often_enough(min_visits):
    rng = np.random.default_rng(0)
    points = rng.random((3000, 3)) * [3, 3, 0.2]
    visits = np.zeros(len(points), int)
    for center, indices in cover(points, 0.5, 300, min_visits, rng):
        assert len(indices) <= 300 and len(np.unique(indices)) == len(indices)
        assert np.linalg.norm(points[indices] - center, axis=1).max() <= 0.5 + 1e-9
        visits[indices] += 1
    assert visits.min() >= min_visits
    assert visits.mean() < 6 * min_visits
