"""A skeleton is split into axes by the thickness of its wood."""

import numpy as np

from cherrypicker.skeleton.axes import axes
from cherrypicker.skeleton.model import Skeleton


def with_a_stub(radius, at):
    """A stem of 1 m, nodes every cm of these radii, m, from which a stub leaves at a node."""
    height = np.arange(0, 1.0, 0.01)
    stem = np.column_stack([0 * height, 0 * height, height])
    side = np.column_stack([0.01 * np.arange(1, 30), np.zeros(29), np.full(29, height[at])])
    parent = np.concatenate([np.arange(len(stem)) - 1, [at], len(stem) + np.arange(28)])
    radii = np.concatenate([radius(height), np.full(29, 0.02)])
    return Skeleton(np.vstack([stem, side]), parent, radii, np.full(len(parent), 2)), len(stem)


def test_the_flare_at_the_root_ends_no_trunk():
    skeleton, n_stem = with_a_stub(lambda z: np.where(z < 0.05, 0.10, 0.06), 6)
    assert len(axes(skeleton)[0].nodes) == n_stem


def test_a_ring_below_a_stub_ends_no_trunk():
    skeleton, n_stem = with_a_stub(lambda z: np.where(abs(z - 0.40) < 0.06, 0.07, 0.05), 50)
    assert len(axes(skeleton)[0].nodes) == n_stem


def test_a_trunk_ends_where_it_loses_its_thickness():
    skeleton, n_stem = with_a_stub(lambda z: np.where(z < 0.52, 0.05, 0.035), 50)
    assert len(axes(skeleton)[0].nodes) < n_stem
