"""The region of interest from the cameras alone."""

from dataclasses import replace

import numpy as np
from scan_scene import look_at_poses, ring, rotation_about

from cherrypicker.placement.region import find_region, framing

TARGET = np.array([0.0, 0.0, 1.2])


def test_a_ring_looks_at_its_middle_as_far_as_it_is_wide():
    region = find_region(look_at_poses(ring(), TARGET))
    np.testing.assert_allclose(region.center, TARGET, atol=1e-6)
    np.testing.assert_allclose(region.radius, 3.0, rtol=0.06)
    assert region.holds(region.samples).all()
    # the samples fill the ball: their mean is its middle
    assert np.linalg.norm(region.samples.mean(axis=0) - TARGET) < 0.02 * region.radius


def test_half_a_ring_and_two_alleys_look_at_the_tree_as_well():
    half = look_at_poses(ring(arc_deg=180.0), TARGET)
    x = np.tile(np.linspace(-1.5, 1.5, 15), 2)
    alleys = np.column_stack([x, np.repeat([-2.5, 2.5], 15), np.full(30, 1.3)])
    for poses in (half, look_at_poses(alleys, TARGET)):
        np.testing.assert_allclose(find_region(poses).center, TARGET, atol=1e-4)


def test_the_region_moves_with_the_frame():
    poses = look_at_poses(ring(), TARGET + np.random.default_rng(0).normal(0, 0.2, (40, 3)))
    here = find_region(poses)
    turn, shift = rotation_about([1, 2, 3], 50.0), np.array([4.0, -2.0, 7.0])
    there = find_region(poses.transformed(0.3, turn, shift))
    np.testing.assert_allclose(there.center, 0.3 * turn @ here.center + shift, atol=1e-6)
    np.testing.assert_allclose(there.radius, 0.3 * here.radius, rtol=1e-6)


def test_a_walk_along_a_row_and_a_facade_have_no_common_place(caplog):
    facing = look_at_poses(np.array([[0.0, -3.0, 1.3]]), TARGET).rotations[0]
    centers = np.column_stack([np.linspace(-6, 6, 40), np.full(40, -3.0), np.full(40, 1.3)])
    poses = look_at_poses(centers, TARGET)
    rows = [np.column_stack([facing, -facing @ center]) for center in centers]
    assert find_region(replace(poses, cam_from_world=np.array(rows))) is None
    assert "no common place" in caplog.text


def row_walk(half=5.0, aside=2.5, n=40):
    """Along both alleys of a row from -half to half, through a wide lens; and the row's trees."""
    x = np.linspace(-half, half, n)
    centers = np.column_stack([np.tile(x, 2), np.repeat([-aside, aside], n), np.full(2 * n, 1.3)])
    targets = np.column_stack([0.75 * np.tile(x, 2), np.zeros(2 * n), np.full(2 * n, 1.2)])
    feet = np.column_stack([np.linspace(-half + 1, half - 1, 5), np.zeros((5, 2))])
    return look_at_poses(centers, targets, focal=400.0), feet


def test_the_region_of_several_trees_holds_the_whole_row():
    poses, feet = row_walk()
    one = find_region(poses)
    assert one is not None and not one.holds(feet[[0, -1]]).any()  # the fault, were it taken
    region = find_region(poses, several=True)
    tops = feet + [0.0, 0.0, 3.0]
    assert region.holds(feet).all() and region.holds(tops).all()
    assert region.holds(poses.centers).all()
    assert framing(poses, region).any(axis=1).all()


def test_several_trees_need_no_common_place():
    poses, _ = row_walk(half=8.0)
    narrow = look_at_poses(poses.centers, poses.centers * [1, 0, 0] + [0.3, 0, 1.2], focal=1500.0)
    assert find_region(narrow) is None
    assert find_region(narrow, several=True).holds(narrow.centers).all()


def test_what_lies_before_the_lens_is_not_framed():
    poses = look_at_poses(ring(n=8), TARGET)
    region = find_region(poses)
    near = poses.centers[0] + 0.2 * (TARGET - poses.centers[0])
    deep = poses.centers[0] + 0.6 * (TARGET - poses.centers[0])
    framed = framing(poses, replace(region, samples=np.stack([near, deep])))
    assert framed[0].tolist() == [False, True]
