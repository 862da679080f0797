"""A skeleton is split into axes by the thickness of its wood."""

import numpy as np

from cherrypicker.skeleton.axes import axes
from cherrypicker.skeleton.model import Skeleton


def test_the_flare_at_the_root_ends_no_trunk():
    height = np.arange(0, 1.0, 0.01)
    stem = np.column_stack([0 * height, 0 * height, height])
    radius = np.where(height < 0.05, 0.10, 0.06)
    side = np.column_stack([0.01 * np.arange(1, 30), np.zeros(29), np.full(29, 0.06)])
    parent = np.concatenate([np.arange(len(stem)) - 1, [6], len(stem) + np.arange(28)])
    skeleton = Skeleton(
        np.vstack([stem, side]),
        parent,
        np.concatenate([radius, np.full(29, 0.02)]),
        np.full(len(parent), 2),
    )
    assert len(axes(skeleton)[0].nodes) == len(stem)
