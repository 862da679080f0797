"""Fewer points of what is no tree, in any frame: all of the tree stays."""

import numpy as np
import pytest
from scan_scene import arbitrary_frame, ground_points, look_at_poses, ring, tree_points

from cherrypicker.placement.bare_ground import needed_points
from cherrypicker.placement.region import find_region

TARGET = np.array([0.0, 0.0, 1.2])
SPACING = 0.02  # 6 cm of 3 m


@pytest.mark.parametrize("hills", [0.0, 0.1])
def test_a_tree_and_the_ground_at_its_foot_keep_all_points(hills):
    rng = np.random.default_rng(0)
    ground = ground_points(rng, reach=7.0, n=500_000, hills=hills)
    tree = tree_points(rng)
    points = np.concatenate([ground, tree])
    moved, poses = arbitrary_frame(points, look_at_poses(ring(), TARGET))[:2]
    keep = needed_points(moved, poses, find_region(poses), SPACING)
    assert keep[len(ground) :].all()
    away = np.hypot(*ground[:, :2].T)
    assert keep[: len(ground)][away < 0.1].all()
    bare = keep[: len(ground)][(away > 0.8) & (away < 2.5)]
    n_voxels = np.pi * (2.5**2 - 0.8**2) / (SPACING * 3.07) ** 2
    assert n_voxels * 0.8 < bare.sum() < n_voxels * 3 < 0.5 * len(bare)
    beyond = keep[: len(ground)][away > 4]
    assert 0 < beyond.sum() < 0.1 * len(beyond)


def test_what_a_wider_crop_keeps_is_not_beyond():
    rng = np.random.default_rng(3)
    neighbour = tree_points(rng, foot=(4.5, 0.0, 0.0))
    points = np.concatenate([ground_points(rng), tree_points(rng), neighbour])
    poses = look_at_poses(ring(), TARGET)
    region, is_own = find_region(poses), points[:, 2] > 0.3
    at_neighbour = is_own & (points[:, 0] > 3.2)
    assert not needed_points(points, poses, region, SPACING)[at_neighbour].all()
    for margin in (0.5, None):
        keep = needed_points(points, poses, region, SPACING, margin_fraction=margin)
        assert keep[at_neighbour].all()


def test_the_top_of_a_tall_tree_is_not_beyond():
    rng = np.random.default_rng(1)
    points = np.concatenate([ground_points(rng), tree_points(rng, height=9.0)])
    poses = look_at_poses(ring(), TARGET)
    keep = needed_points(points, poses, find_region(poses), SPACING)
    assert points[:, 2].max() > 2 * 3.07
    assert keep[points[:, 2] > 0.3].all()


def test_without_ground_that_the_cameras_stand_on_nothing_goes():
    points = np.random.default_rng(2).normal(size=(20_000, 3)) + TARGET
    poses = look_at_poses(ring(), TARGET)
    assert needed_points(points, poses, find_region(poses), SPACING).all()
