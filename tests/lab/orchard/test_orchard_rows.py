"""A generated row: crowns that touch, photos from both alleys."""

import numpy as np
import pytest

from cherrypicker_lab.orchard.rows import (
    SPACING_SHARE,
    alley_poses,
    row_scene,
)
from cherrypicker_lab.orchard.truth import tree_traits


@pytest.mark.parametrize("seed", [1, 2])
def test_crowns_reach_into_one_another_and_photos_come_from_both_sides(seed):
    scene = row_scene(seed)
    feet = np.sort(scene.offsets[:, 0])
    width = tree_traits(scene.target)["crown_width_m"]
    share = np.diff(feet).mean() / width
    assert len(feet) == 5 and SPACING_SHARE[0] * 0.9 < share < SPACING_SHARE[1] * 1.1
    centers = alley_poses(scene).centers
    sides = np.sign(centers[:, 1])
    assert (sides > 0).sum() == (sides < 0).sum()
    for side in (-1, 1):  # a photo at least every 0.4 m of the row, on either side
        x = np.sort(centers[sides == side, 0])
        assert np.diff(x).max() < 0.4 and x[0] < feet[0] and x[-1] > feet[-1]
