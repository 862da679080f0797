"""Compiled helpers of the graph stage against plain NumPy and SciPy."""

import numpy as np
import pytest
from scipy.optimize import isotonic_regression, minimize

from cherrypicker.geometry.sampling import farthest_point_sample
from cherrypicker.geometry.tree_walks import (
    fill_reach,
    sum_from_root,
    sum_from_tips,
    window,
)
from cherrypicker.graph.extract import isotonic_radii

PARENT = np.array([-1, 0, 1, 1, 3, 3, 0])
LENGTH = np.array([0.0, 1.0, 5.0, 2.0, 1.0, 4.0, 3.0])


def test_walks_of_a_tree_that_one_can_count():
    assert fill_reach(PARENT, LENGTH).tolist() == [7, 6, 0, 4, 0, 0, 0]
    assert sum_from_root(PARENT, LENGTH).tolist() == [0, 1, 6, 3, 4, 7, 3]
    assert sum_from_tips(PARENT, LENGTH).tolist() == [16, 13, 5, 7, 1, 4, 3]


@pytest.mark.parametrize(("reach", "nodes"), [(0.5, [3]), (1.5, [3, 2, 4]), (9.0, [3, 2, 4, 5])])
def test_window_ends_at_forks_and_at_its_reach(reach, nodes):
    parent = np.array([-1, 0, 1, 2, 3, 4, 5, 5, 1])
    length = np.where(parent < 0, 0.0, 1.0)
    found = np.empty(len(parent), dtype=np.int64)
    only_child = np.array([1, -1, 3, 4, 5, -1, -1, -1, -1])
    n = window(3, (parent, length, only_child), reach, found)
    assert found[:n].tolist() == nodes


@pytest.mark.parametrize("n", [1, 2, 40])
def test_radii_of_one_axis_are_the_isotonic_regression(n):
    rng = np.random.default_rng(n)
    radius, weights = rng.uniform(1, 2, n), rng.uniform(0.1, 1, n)
    wanted = isotonic_regression(radius, weights=weights, increasing=False).x
    found = isotonic_radii(np.arange(-1, n - 1), radius, weights**-0.5)
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_farthest_points_are_those_of_the_plain_algorithm():
    points = np.random.default_rng(4).normal(size=(600, 3))
    samples, nearest = farthest_point_sample(points, 0.5, first=17)
    away = np.linalg.norm(points[:, None] - points[samples], axis=2)
    for position in range(1, len(samples)):
        so_far = away[:, :position].min(axis=1)
        assert samples[position] == np.argmax(so_far)
        assert so_far.max() > 0.5
    assert away.min(axis=1).max() <= 0.5
    np.testing.assert_array_equal(nearest, np.argmin(away, axis=1))


def test_radii_of_a_tree_are_the_nearest_that_never_grow():
    rng = np.random.default_rng(0)
    parent = np.array([-1, *(rng.integers(max(i - 6, 0), i) for i in range(1, 60))])
    radius, weights = rng.uniform(0.01, 0.05, 60), rng.uniform(0.2, 2.0, 60)
    found = isotonic_radii(parent, radius, weights**-0.5)
    assert (found[1:] <= found[parent[1:]] + 1e-12).all()
    limits = [
        {"type": "ineq", "fun": lambda r, i=i: r[parent[i]] - r[i]} for i in range(1, len(parent))
    ]
    wanted = minimize(
        lambda r: 1e4 * (weights * (r - radius) ** 2).sum(),
        np.full(60, 0.03),
        constraints=limits,
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-12},
    )
    np.testing.assert_allclose(found, wanted.x, atol=2e-5)


def test_a_limb_is_not_made_thin_by_its_fork_nor_a_stem_thick_by_a_limb_without_points():
    radius = np.repeat([0.04, 0.008, 0.022, 0.06], [51, 4, 60, 9])
    error = np.repeat([0.0002, 0.001, 0.0002, 0.0], [51, 4, 60, 9])
    found = isotonic_radii(np.arange(-1, len(radius) - 1), radius, error)
    np.testing.assert_allclose(found[:51], 0.04)
    np.testing.assert_allclose(found[51:], 0.022, atol=1e-4)
