"""The evaluation against a scene's truth, on results whose errors are known."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scan_scene import look_at_poses, rotation_about

from cherrypicker.errors import StageError
from cherrypicker.pointcloud import PointCloud, write_cloud
from cherrypicker.poses import write_poses
from cherrypicker.skeleton import Skeleton, write_skeleton_graphml
from cherrypicker_lab.evaluation import (
    camera_similarity,
    compare_cameras,
    compare_labels,
    compare_skeletons,
    evaluate,
    missed_bars,
    pair_cameras,
)


def ring(n=20):
    """Cameras around the z axis that look at it."""
    turn = 2 * np.pi * np.arange(n) / n
    centers = np.column_stack([2.5 * np.cos(turn), 2.5 * np.sin(turn), 1 + 0.3 * np.sin(3 * turn)])
    return look_at_poses(centers, np.zeros(3), focal=900.0)


def y_skeleton():
    stem = [[0, 0, 0.02 * i] for i in range(51)]
    left = [[0.02 * i, 0, 1 + 0.02 * i] for i in range(1, 26)]
    right = [[-0.02 * i, 0, 1 + 0.02 * i] for i in range(1, 26)]
    parent = [-1, *range(50), 50, *range(51, 75), 50, *range(76, 100)]
    radius = [0.04] * 51 + [0.01] * 25 + [0.003] * 25
    return Skeleton(stem + left + right, parent, radius, [1] * 51 + [2] * 50)


def write_scene(folder, skeleton, traits):
    truth = folder / "truth"
    truth.mkdir(parents=True)
    write_poses(truth / "poses.npz", ring())
    lines = ["id,parent,x,y,z,radius,order,label"]
    for i, (p, point) in enumerate(zip(skeleton.parent, skeleton.points, strict=True)):
        x, y, z = point
        lines.append(f"{i},{p},{x:.5f},{y:.5f},{z:.5f},{skeleton.radius[i]:.5f},{int(i > 50)},1")
    (truth / "skeleton.csv").write_text("\n".join(lines) + "\n")
    (truth / "traits.json").write_text(json.dumps(traits))
    labels = np.ones(len(skeleton), np.uint8)
    write_cloud(truth / "cloud.ply", PointCloud(skeleton.points, fields={"label": labels}))
    return truth


TRAITS = {
    "height_m": 1.5,
    "trunk_diameter_m": 0.08,
    "trunk_height_m": 0.3,
    "total_length_m": 2.4,
    "n_tips": 2,
}


def write_results(folder, skeleton, poses, **changes):
    folder.mkdir(parents=True)
    write_skeleton_graphml(folder / "skeleton.graphml", skeleton)
    traits = TRAITS | {"unit": "m", "n_junctions": 1} | changes
    (folder / "traits.json").write_text(json.dumps(traits))
    write_poses(folder / "metric_poses.npz", poses)
    labels = np.ones(len(skeleton), np.uint8)
    write_cloud(folder / "segmented.ply", PointCloud(skeleton.points, fields={"label": labels}))
    return folder


def moved(skeleton, scale=1.0, turn=None, shift=(0, 0, 0)):
    turn = np.eye(3) if turn is None else turn
    points = scale * skeleton.points @ turn.T + np.asarray(shift)
    return Skeleton(points, skeleton.parent, scale * skeleton.radius, skeleton.label)


def test_a_perfect_result_in_another_frame_meets_every_bar(tmp_path):
    truth = write_scene(tmp_path / "scene", y_skeleton(), TRAITS)
    turn, shift = rotation_about([0, 0, 1], 130), np.array([0.4, -0.2, 0.03])
    results = write_results(
        tmp_path / "tree",
        moved(y_skeleton(), 1, turn, shift),
        ring().transformed(1.0, turn, shift),
    )
    report = evaluate(results, truth)
    assert [bar.name for bar in missed_bars(report)] == ["branch_f1"]  # the scene has no branch
    assert report["registered_fraction"] == 1.0
    assert report["scale_error"] < 1e-9
    assert report["up_error_deg"] < 1e-4
    assert report["skeleton_recall"] == report["skeleton_precision"] == 1.0
    assert report["label_f1"]["trunk"] == 1.0


def test_known_errors_are_measured(tmp_path):
    truth = write_scene(tmp_path / "scene", y_skeleton(), TRAITS)
    turn = rotation_about([1, 0, 0], 2.0)
    results = write_results(
        tmp_path / "tree",
        moved(y_skeleton(), 1.01, turn),
        ring().transformed(1.01, turn).select(np.arange(18)),
        height_m=1.6,
        trunk_diameter_m=0.09,
    )
    report = evaluate(results, truth)
    assert report["registered_fraction"] == pytest.approx(0.9)
    assert report["scale_error"] == pytest.approx(0.01, rel=1e-3)
    assert report["up_error_deg"] == pytest.approx(2.0, abs=0.01)
    assert report["height_error"] == pytest.approx(0.1 / 1.5)
    assert report["trunk_diameter_error_m"] == pytest.approx(0.01)
    names = {bar.name for bar in missed_bars(report)}
    assert names == {
        "registered_fraction",
        "scale_error",
        "up_error_deg",
        "height_error",
        "trunk_diameter_error_m",
        "branch_f1",  # the scene has no branch
    }


def test_diameters_at_two_heights_are_not_compared(tmp_path):
    truth = write_scene(tmp_path / "scene", y_skeleton(), TRAITS)
    results = write_results(tmp_path / "tree", y_skeleton(), ring(), trunk_height_m=0.5)
    with pytest.raises(StageError, match="at 0.5 m, its truth is that at 0.3 m.*trunk_height_m"):
        evaluate(results, truth)


def test_recall_and_precision_are_lengths():
    truth = y_skeleton()
    without_left = truth.select(~((np.arange(101) > 50) & (np.arange(101) < 76)))
    report = compare_skeletons(without_left, truth)
    arm = 0.5 * np.sqrt(2)
    assert report["skeleton_recall"] == pytest.approx(1 / (1 + arm), abs=0.03)
    assert report["skeleton_precision"] == 1.0
    report = compare_skeletons(truth, without_left)
    assert report["skeleton_recall"] == 1.0
    assert report["skeleton_precision"] == pytest.approx(1 / (1 + arm), abs=0.03)


def test_thin_wood_does_not_count_for_recall():
    truth = y_skeleton()
    without_twig = truth.select(np.arange(101) < 76)
    report = compare_skeletons(without_twig, truth)
    assert report["skeleton_recall"] == pytest.approx(1.0, abs=0.01)
    assert report["skeleton_recall_all"] < 0.8


def test_a_false_tip_does_not_fill_in_for_a_missed_one():
    truth, moved = y_skeleton(), y_skeleton()
    assert compare_skeletons(moved, truth)["tips_f1"] == 1.0
    moved.points[76:, 1] += 0.1
    assert compare_skeletons(moved, truth)["tips_f1"] == 0.5
    assert compare_skeletons(truth.select(np.arange(101) < 76), truth)["tips_f1"] == 2 / 3


def test_one_lost_camera_does_not_move_the_rest():
    found = ring()
    found.cam_from_world[3, :, 3] += 0.8
    report = compare_cameras(found, ring())
    assert report["scale_error"] < 1e-6
    assert report["up_error_deg"] < 1e-3


def test_labels_by_nearest_true_point():
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [9, 9, 9]], float)
    report = compare_labels(points, np.array([1, 1, 2, 2]), points[:3], np.array([1, 2, 2]))
    assert report["label_matched"] == 0.75
    assert report["label_f1"] == {"trunk": pytest.approx(2 / 3), "branch": pytest.approx(2 / 3)}


def test_cameras_of_another_scene_are_the_users_error():
    found = ring()
    found.names = np.array([f"other_{i}.jpg" for i in range(len(found))])
    with pytest.raises(StageError, match="0 photos"):
        compare_cameras(found, ring())


def test_cameras_place_a_cloud_despite_one_wrong_pose():
    rng = np.random.default_rng(2)
    centers, names = rng.normal(size=(12, 3)), np.array([f"{i}.jpg" for i in range(12)])
    turn = rotation_about([0.3, -1.0, 2.0], 128.0)
    seen = (centers - [1.0, 2.0, 3.0]) @ turn / 0.4
    seen[3] += 5.0
    truth = SimpleNamespace(names=names, centers=centers)
    pairs = pair_cameras(SimpleNamespace(names=names[::-1], centers=seen[::-1]), truth)
    scale, found, shift, keep = camera_similarity(*pairs)
    assert np.flatnonzero(~keep).tolist() == [8]
    assert scale == pytest.approx(0.4)
    np.testing.assert_allclose(found, turn, atol=1e-9)
    np.testing.assert_allclose(shift, [1.0, 2.0, 3.0], atol=1e-9)
    with pytest.raises(StageError, match="three are needed"):
        pair_cameras(SimpleNamespace(names=names[:2], centers=seen[:2]), truth)
