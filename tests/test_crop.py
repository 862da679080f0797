"""Region of interest: the camera box, the target and its neighbours."""

import numpy as np
import pytest
from scan_scene import ground_points, look_at_poses, ring, tree_points

from cherrypicker.crop import camera_box, crop_roi
from cherrypicker.errors import StageError

TARGET = np.array([0.0, 0.0, 1.2])


def orchard(seed=0, neighbours=((2.2, 0.3), (5.0, 0.0))):
    rng = np.random.default_rng(seed)
    trees = [tree_points(rng)] + [tree_points(rng, foot=(*xy, 0.0)) for xy in neighbours]
    return np.concatenate([ground_points(rng), *trees])


def test_box_is_that_of_the_cameras():
    points, poses = orchard(), look_at_poses(ring(), TARGET)
    crop = crop_roi(points, poses)
    low, high = poses.centers[:, :2].min(axis=0), poses.centers[:, :2].max(axis=0)
    np.testing.assert_allclose(
        np.stack([crop.report["box"]["x"], crop.report["box"]["y"]]).T, [low, high]
    )
    kept = points[crop.keep]
    assert (kept[:, :2] >= low).all() and (kept[:, :2] <= high).all()
    inside = ((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)
    assert crop.keep.sum() == inside.sum()
    assert kept[:, 2].max() == points[inside][:, 2].max()


def test_margin_widens_each_side():
    points, poses = orchard(), look_at_poses(ring(), TARGET)
    plain, wide = crop_roi(points, poses), crop_roi(points, poses, margin_fraction=0.25)
    extent = np.ptp(plain.report["box"]["x"])
    assert np.ptp(wide.report["box"]["x"]) == pytest.approx(1.5 * extent)


def test_target_and_neighbours_are_found():
    crop = crop_roi(orchard(), look_at_poses(ring(), TARGET))
    np.testing.assert_allclose(crop.report["target_xy"], 0, atol=0.03)
    assert crop.report["target_source"] == "stem"
    others = crop.report["other_stems"]
    assert len(others) == 1
    np.testing.assert_allclose([others[0]["x"], others[0]["y"]], [2.2, 0.3], atol=0.05)
    assert any("another stem" in warning for warning in crop.report["warnings"])


def test_target_xy_chooses_the_other_tree():
    crop = crop_roi(orchard(), look_at_poses(ring(), TARGET), target_xy=[2.2, 0.3])
    assert crop.report["target_source"] == "config"
    assert crop.report["target_xy"] == [2.2, 0.3]
    np.testing.assert_allclose(
        [crop.report["stem"]["x"], crop.report["stem"]["y"]], [2.2, 0.3], atol=0.05
    )
    np.testing.assert_allclose(
        [crop.report["other_stems"][0]["x"], crop.report["other_stems"][0]["y"]], 0, atol=0.05
    )


def test_points_deep_below_the_ground_go():
    points = orchard()
    noise = np.column_stack([np.random.default_rng(1).uniform(-2, 2, (500, 2)), np.full(500, -1.5)])
    crop = crop_roi(np.concatenate([points, noise]), look_at_poses(ring(), TARGET))
    assert not crop.keep[len(points) :].any()
    near = np.hypot(points[:, 0], points[:, 1]) < 2
    assert crop.keep[: len(points)][near].all()


def test_photos_from_one_side_still_enclose_the_tree():
    points = orchard(neighbours=())
    row = np.column_stack([np.linspace(-1, 1, 20), np.full(20, -3.0), np.full(20, 1.3)])
    crop = crop_roi(points, look_at_poses(row, TARGET))
    tree = np.hypot(points[:, 0], points[:, 1]) < 1.2
    assert crop.keep[tree].all()
    assert any("unseen" in warning for warning in crop.report["warnings"])


def test_both_sides_of_a_row():
    x = np.tile(np.linspace(-1.5, 1.5, 15), 2)
    centers = np.column_stack([x, np.repeat([-2.5, 2.5], 15), np.full(30, 1.3)])
    warnings = []
    box = camera_box(centers, np.zeros(2), 0.0, 3.0, warnings)
    np.testing.assert_allclose(box, [[-1.5, -2.5], [1.5, 2.5]])
    assert not warnings
    centers[:, 0] *= 0.3
    box = camera_box(centers, np.zeros(2), 0.0, 3.0, warnings)
    np.testing.assert_allclose(box, [[-1.5, -2.5], [1.5, 2.5]])
    assert "widened" in warnings[0]


def test_empty_box_and_bad_target_name_the_key():
    points, poses = orchard(), look_at_poses(ring(), TARGET)
    far = points + [50, 0, 0]
    with pytest.raises(StageError) as caught:
        crop_roi(far, poses)
    assert caught.value.key == "crop.margin_fraction"
    with pytest.raises(StageError) as caught:
        crop_roi(points, poses, target_xy=[99, 0])
    assert caught.value.key == "crop.target_xy"
