"""The foot of a stem whose label is wrong, or missing, at its lower end."""

import numpy as np
import pytest

from cherrypicker.graph.samples import find_root
from cherrypicker.wood.feet import lowest_thick


def leaning_branch(seed=0):
    """Contracted points of a leaning stem with a twig that hangs below its foot."""
    rng = np.random.default_rng(seed)
    stem = np.linspace(0, 1, 900)[:, None] * (1.2, 0.0, 3.0)
    twig = (0.15, 0, 0.25) + np.linspace(0, 1, 24)[:, None] * (0.3, 0.1, -0.33)
    points = np.vstack([stem, twig]) + rng.normal(0, 0.002, (924, 3))
    return points, np.arange(924) >= 900


@pytest.mark.parametrize("base", [None, (0.1, 0.0, 0.25)])
@pytest.mark.parametrize("stray", ["none", "twig", "upper stem and twig"])
def test_the_foot_is_found_without_its_label(base, stray):
    points, is_twig = leaning_branch()
    labels = np.full(len(points), 2)
    if "twig" in stray:
        labels[np.flatnonzero(is_twig)[[12, 22]]] = 1
    if "upper" in stray:
        labels[~is_twig & (points[:, 2] > 0.5)] = 1
    root = find_root(points, labels, base)
    assert not is_twig[root]
    assert points[root, 2] < 0.02


def test_a_label_that_reaches_the_foot_is_believed():
    points, is_twig = leaning_branch()
    labels = np.where(is_twig, 2, 1)
    labels[points[:, 2] < 0.04] = 2  # soil clods taken for a branch
    labels[is_twig] = 2
    root = find_root(points, labels)
    assert labels[root] == 1 and points[root, 2] < 0.08


def test_lowest_thick_wood_ignores_thin_ends():
    points, is_twig = leaning_branch()
    assert np.argmin(points[:, 2]) in np.flatnonzero(is_twig)
    assert points[lowest_thick(points, 0.06, 0.3), 2] < 0.02
