"""Compiled helpers of the graph stage against plain NumPy and SciPy."""

import numpy as np
import pytest
from scipy.optimize import isotonic_regression, minimize

from cherrypicker.geometry.sampling import farthest_point_sample
from cherrypicker.geometry.tree_walks import (
    child_rows,
    fill_reach,
    longest_children,
    sum_from_root,
    window,
)
from cherrypicker.graph.radius import _never_growing, _running_medians, taper_skeleton
from cherrypicker.skeleton.model import Skeleton

PARENT = np.array([-1, 0, 1, 1, 3, 3, 0])
LENGTH = np.array([0.0, 1.0, 5.0, 2.0, 1.0, 4.0, 3.0])


def test_walks_of_a_tree_that_one_can_count():
    start, child = child_rows(PARENT)
    rows = [child[start[node] : start[node + 1]].tolist() for node in range(len(PARENT))]
    assert rows == [[1, 6], [2, 3], [], [4, 5], [], [], []]
    assert fill_reach(PARENT, LENGTH).tolist() == [7, 6, 0, 4, 0, 0, 0]
    assert sum_from_root(PARENT, LENGTH).tolist() == [0, 1, 6, 3, 4, 7, 3]
    heir = longest_children(PARENT, fill_reach(PARENT, LENGTH) + LENGTH)
    assert heir.tolist() == [1, 3, -1, 5, -1, -1, -1]


@pytest.mark.parametrize(("reach", "nodes"), [(0.5, [3]), (1.5, [3, 2, 4]), (9.0, [3, 2, 4, 5])])
def test_window_ends_at_forks_and_at_its_reach(reach, nodes):
    parent = np.array([-1, 0, 1, 2, 3, 4, 5, 5, 1])
    length = np.where(parent < 0, 0.0, 1.0)
    found = np.empty(len(parent), dtype=np.int64)
    n = window(3, parent, length, *child_rows(parent), reach, found)
    assert found[:n].tolist() == nodes


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6, 40])
def test_taper_is_the_isotonic_regression_of_the_running_median(n):
    rng = np.random.default_rng(n)
    radius, weights = rng.uniform(1, 2, n), rng.uniform(0.1, 1, n)
    half = {1: 0, 2: 0, 3: 1, 4: 1}.get(n, 2)
    padded = np.pad(radius, half, mode="edge")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    wanted = isotonic_regression(medians, weights=weights, increasing=False).x
    smooth = _running_medians(np.arange(n), np.array([0, n]), radius)
    np.testing.assert_allclose(smooth, medians, rtol=1e-15)
    found = _never_growing(np.arange(-1, n - 1), smooth, weights)
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
    found = _never_growing(parent, radius, weights)
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


def test_a_limb_is_not_made_thin_by_its_fork():
    stem = np.column_stack([np.zeros((51, 2)), np.linspace(0, 1, 51)])
    twig = stem[50] + np.column_stack([0.01 * np.arange(1, 5), np.zeros(4), 0.01 * np.arange(1, 5)])
    limb = twig[-1] + np.column_stack([np.zeros(60), 0.01 * np.arange(1, 61), np.zeros(60)])
    n = 51 + 4 + 60
    radius = np.concatenate([np.full(51, 0.04), np.full(4, 0.008), np.full(60, 0.022)])
    fields = {"arc_deg": np.full(n, 360.0), "n_points": np.full(n, 400)}
    fields["n_points"][51:55] = 20  # of a fork, whose points most nodes share
    skeleton = Skeleton(
        np.vstack([stem, twig, limb]), np.arange(-1, n - 1), radius, np.ones(n, dtype=int), fields
    )
    tapered = taper_skeleton(skeleton).radius
    assert (tapered[55:] > 0.021).all()
    assert (tapered[51:55] > 0.021).all()
    np.testing.assert_allclose(tapered[:51], 0.04)
