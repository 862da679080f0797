"""Gravity that the photos state: joined, weighed against the rolls, never trusted alone."""

import numpy as np
import pytest
from scan_scene import arbitrary_frame, ground_points, look_at_poses, ring, tree_points

from cherrypicker.geometry.directions import angle_deg
from cherrypicker.placement.align import align
from cherrypicker.placement.up import Evidence, photos_up, solve_up

TARGET = np.array([0.0, 0.0, 1.2])
UP = np.array([0.0, 0.0, 1.0])


def stated(poses, noise_deg=1.0, seed=0):
    rng = np.random.default_rng(seed)
    return list(poses.rotations @ UP + rng.normal(0, np.radians(noise_deg), (len(poses), 3)))


def half_ring_held_askew():
    """From one side, each photo rolled the same way: a tilt that the rolls cannot know."""
    rng = np.random.default_rng(3)
    points = np.concatenate([ground_points(rng), tree_points(rng)])
    points[:, 2] += np.tan(np.radians(4)) * points[:, 0] * (points[:, 2] < 0.1)
    return points, look_at_poses(ring(30, arc_deg=150), TARGET, roll_deg=rng.normal(3.0, 1.0, 30))


def test_photos_agree_on_a_direction_and_some_wrong_ones_do_not_move_it():
    poses = look_at_poses(ring(30), TARGET)
    ups = stated(poses)
    ups[3], ups[9], ups[20] = None, np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    rolls, found = photos_up(poses), photos_up(poses, stated_ups=ups)
    assert found.gravity["gravity_n_photos"] == 29 and angle_deg(found.up, UP) < 0.6
    assert found.gravity["gravity_spread_deg"] == pytest.approx(1.2, abs=0.4)
    assert not rolls.gravity["gravity_is_used"]
    few = photos_up(poses, stated_ups=[None] * 28 + ups[:2])
    assert not few.gravity["gravity_is_used"] and not few.warnings
    np.testing.assert_array_equal(few.up, rolls.up)


def test_what_an_accelerometer_is_off_in_all_photos_is_solved_for():
    """By 2 degrees, of photos from one side, where it does not cancel."""
    poses, errors = look_at_poses(ring(40, arc_deg=150), TARGET), []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        offset, noise = np.radians(rng.normal(0, 2.0, 3)), np.radians(1.0)
        values = poses.rotations @ UP + offset + rng.normal(0, noise, (40, 3))

        def off(up, poses=poses, values=values):
            return poses.rotations @ up - values

        known = solve_up([Evidence(off, noise, np.radians(2.0))], UP)
        blind = solve_up([Evidence(off, noise)], UP)
        errors.append([angle_deg(known[0], UP), angle_deg(blind[0], UP)])
    known_rms, blind_rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert known_rms < 0.5 * blind_rms
    assert 0.5 < known_rms / known[1] < 2.0


def test_gravity_takes_the_place_of_rolls():
    points, poses = half_ring_held_askew()
    ups = stated(poses)
    moved, moved_poses, (_, turn, _) = arbitrary_frame(points, poses)
    plain = align(moved, moved_poses)
    known = align(moved, moved_poses, stated_ups=ups)
    off = [angle_deg(each.rotation @ turn @ UP, UP) for each in (plain, known)]
    assert off[1] < 0.7 and off[1] < 0.5 * off[0]
    assert known.report["gravity_is_used"] and known.report["gravity_n_photos"] == 30
    assert not plain.report["gravity_is_used"]


@pytest.mark.parametrize("what", ["turned by a program", "at random", "loosely", "all askew"])
def test_gravity_that_contradicts_itself_or_the_rolls_is_not_used(what):
    points, poses = half_ring_held_askew()
    ups = stated(poses)
    if what == "turned by a program":
        ups = [np.array([-y, x, z]) for x, y, z in ups]
    elif what == "at random":
        ups = list(np.random.default_rng(1).normal(size=(30, 3)))
    elif what == "loosely":  # about the true direction
        ups = stated(poses, noise_deg=8.0)
    else:  # by 30 degrees about a level axis, in close agreement
        ups = list(poses.rotations @ [0.0, 0.5, np.sqrt(0.75)])
    result = align(points, poses, stated_ups=ups)
    np.testing.assert_array_equal(result.rotation, align(points, poses).rotation)
    assert not result.report["gravity_is_used"]
    assert any("gravity is not used" in warning for warning in result.report["warnings"])


def test_without_a_ground_gravity_is_the_vertical():
    rng = np.random.default_rng(5)
    poses = look_at_poses(ring(30), TARGET, roll_deg=rng.normal(2.0, 2.0, 30))
    result = align(tree_points(rng), poses, stated_ups=stated(poses))
    assert not result.report["ground_found"]
    assert angle_deg(result.rotation @ UP, UP) < 0.6
