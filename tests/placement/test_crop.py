"""Region of interest: what stands where the cameras look, whatever it is."""

import numpy as np
import pytest
from scan_scene import ground_points, look_at_poses, ring, tree_points

from cherrypicker.errors import StageError
from cherrypicker.placement.crop import crop_roi

TARGET = np.array([0.0, 0.0, 1.2])


def orchard(seed=0, neighbours=((2.2, 0.3), (5.0, 0.0))):
    rng = np.random.default_rng(seed)
    trees = [tree_points(rng)] + [tree_points(rng, foot=(*xy, 0.0)) for xy in neighbours]
    return np.concatenate([ground_points(rng), *trees])


def test_what_stands_where_the_cameras_look_is_kept():
    points, poses = orchard(), look_at_poses(ring(), TARGET)
    keep, report = crop_roi(points, poses)
    np.testing.assert_allclose(report["center"], TARGET, atol=1e-6)
    np.testing.assert_allclose(report["center_xy"], 0, atol=1e-6)
    assert report["source"] == "region" and not report["warnings"]
    assert report["radius"] == report["camera_distance"] == pytest.approx(3.07, abs=0.05)
    np.testing.assert_allclose(report["box"]["x"], [-report["radius"], report["radius"]], atol=1e-6)
    inside = np.hypot(*points[:, :2].T) <= report["radius"]
    np.testing.assert_array_equal(keep, inside)


def test_margin_widens_each_side():
    points, poses = orchard(), look_at_poses(ring(), TARGET)
    (_, plain), (_, wide) = (crop_roi(points, poses, margin_fraction=by) for by in (0.0, 0.25))
    assert wide["radius"] == pytest.approx(1.5 * plain["radius"])


def test_nothing_that_stands_there_moves_the_region():
    """Posts, signs, neighbours, a statue: without scale and classes none is asked."""
    poses = look_at_poses(ring(), TARGET)
    bare = crop_roi(orchard(neighbours=()), poses)[1]
    crowded = crop_roi(orchard(neighbours=((0.4, 0.1), (2.2, 0.3))), poses)[1]
    assert bare["radius"] == crowded["radius"]
    np.testing.assert_array_equal(bare["center"], crowded["center"])
    assert not {"target_xy", "stem", "other_stems", "posts"} & set(crowded)


def test_points_deep_below_the_ground_go():
    points = orchard()
    noise = np.column_stack([np.random.default_rng(1).uniform(-2, 2, (500, 2)), np.full(500, -1.5)])
    keep, _ = crop_roi(np.concatenate([points, noise]), look_at_poses(ring(), TARGET))
    assert not keep[len(points) :].any()
    near = np.hypot(points[:, 0], points[:, 1]) < 2
    assert keep[: len(points)][near].all()


def test_photos_from_one_side_still_enclose_the_tree():
    points = orchard(neighbours=())
    row = np.column_stack([np.linspace(-1, 1, 20), np.full(20, -3.0), np.full(20, 1.3)])
    keep, _ = crop_roi(points, look_at_poses(row, TARGET))
    tree = np.hypot(points[:, 0], points[:, 1]) < 1.2
    assert keep[tree].all()


def test_a_walk_along_a_row_keeps_the_box_before_the_cameras():
    points = orchard(neighbours=((2.2, 0.3), (-2.2, 0.0)))
    walk = np.column_stack([np.linspace(-4, 4, 30), np.full(30, -3.0), np.full(30, 1.3)])
    keep, report = crop_roi(points, look_at_poses(walk, walk + [0, 3, -0.1]))
    assert report["source"] == "camera_box"
    assert "no common place" in report["warnings"][0]
    box = report["box"]
    np.testing.assert_allclose(box["x"], [-4, 4], atol=1e-6)
    assert box["y"][0] == pytest.approx(-3.0) and 0.0 < box["y"][1] < 2.5
    assert report["center_xy"] == pytest.approx(np.mean([box["x"], box["y"]], axis=1))
    assert keep[np.abs(points[:, :2] - [0, -0.5]).max(axis=1) < 0.5].all()


def test_no_tree_of_a_walk_along_both_alleys_is_cut_off():
    feet = [(x, 0.0) for x in np.linspace(-4, 4, 5)]
    points, n = orchard(neighbours=feet[:2] + feet[3:]), 40
    x = np.tile(np.linspace(-5, 5, n), 2)
    walk = np.column_stack([x, np.repeat([-2.5, 2.5], n), np.full(2 * n, 1.3)])
    aims = np.column_stack([0.75 * x, np.zeros(2 * n), np.full(2 * n, 1.2)])
    poses = look_at_poses(walk, aims, focal=400.0)
    is_tree = points[:, 2] > 0.2
    kept, one = crop_roi(points, poses)  # what a single target asks
    assert one["source"] == "region" and not kept[is_tree].all()
    keep, report = crop_roi(points, poses, several=True)
    assert report["source"] == "camera_box" and not report["warnings"]
    assert keep[is_tree].all()
    box = report["box"]
    assert box["x"][0] <= -5 and box["x"][1] >= 5 and box["y"][0] <= -2.5 and box["y"][1] >= 2.5


def test_the_papers_region_is_the_box_of_the_cameras_at_any_height():
    deep = np.array([[0.0, 0.0, -4.0], [0.0, 0.0, 9.0]])
    points, poses = np.concatenate([orchard(), deep]), look_at_poses(ring(arc_deg=200), TARGET)
    keep, report = crop_roi(points, poses, region="cameras")
    low, high = poses.centers.min(axis=0)[:2], poses.centers.max(axis=0)[:2]
    inside = ((low <= points[:, :2]) & (points[:, :2] <= high)).all(axis=1)
    np.testing.assert_array_equal(keep, inside)
    assert keep[-2:].all() and report["source"] == "cameras"
    assert not np.array_equal(crop_roi(points, poses)[0], inside)
    _, wider = crop_roi(points, poses, region="cameras", margin_fraction=0.1)
    assert wider["box"]["x"][0] == pytest.approx(low[0] - 0.1 * (high - low)[0])


def test_an_empty_region_names_the_key():
    points, poses = orchard(), look_at_poses(ring(), TARGET)
    with pytest.raises(StageError) as caught:
        crop_roi(points + [50, 0, 0], poses)
    assert caught.value.key == "crop.margin_fraction"
