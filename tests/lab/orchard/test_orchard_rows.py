"""A generated row: crowns that touch, photos from both alleys."""

import numpy as np
import pytest

from cherrypicker_lab.orchard.rows import (
    MARKERS,
    SPACING_SHARE,
    alley_poses,
    loop_poses,
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


def test_photos_to_render_go_all_round_a_row_and_every_tree_is_in_many():
    scene = row_scene(53, markers=MARKERS)
    poses = loop_poses(scene)
    steps = np.linalg.norm(np.diff(np.vstack([poses.centers, poses.centers[:1]]), axis=0), axis=1)
    assert len(poses) == 100 and steps.max() < 1.3  # heights take turns, 0.9 m apart
    for tree, foot in zip(scene.trees, scene.offsets):
        middle = foot + [0.0, 0.0, 0.5 * tree.skeleton().points[:, 2].max()]
        uv = [poses[i].project(middle[None]) for i in range(len(poses))]
        size = np.array([poses.width[0], poses.height[0]])
        seen = np.array([d[0] > 0 and ((p[0] > 0) & (p[0] < size)).all() for p, d in uv])
        assert seen.sum() >= 20
        assert {-1.0, 1.0} <= set(np.sign(poses.centers[seen, 1]))
    assert [marker["id"] for marker in scene.markers] == [7, 8]
