"""A row's results beside its truth: what is right passes, what is spoilt is told."""

import numpy as np
import pytest
from scan_scene import rotation_about

from cherrypicker.classes import wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import read_json, write_json, write_npz
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses, write_poses
from cherrypicker.skeleton import read_skeleton_csv, write_skeleton_graphml
from cherrypicker_lab.orchard import rows as orchard_rows
from cherrypicker_lab.orchard.scene.mesh import NO_TREE
from cherrypicker_lab.traits.rows import measure_scanned_row, share_scores

TURN, SHIFT = rotation_about([0, 0, 1], 40.0), np.array([0.4, -0.3, 0.1])


def test_wood_of_another_tree_is_wrong_and_ground_is_merely_no_wood():
    owner = np.array([2, 2, 2, 2, 1, 1, 0])
    tree = np.array([0, 0, 1, NO_TREE, 1, 1, 1])
    feet = np.array([[0.0, 0.0], [2.0, 0.0]])
    first, second = share_scores(owner, tree, feet[::-1], feet)
    assert (first["number"], second["number"]) == (2, 1)
    assert first["iou"] == pytest.approx(2 / 4) and first["wrong"] == pytest.approx(1 / 4)
    assert second["iou"] == pytest.approx(2 / 4) and second["wrong"] == 0.0


def test_a_tree_that_nobody_found_has_no_number():
    feet = np.array([[0.0, 0.0], [2.0, 0.0]])
    rows = share_scores(np.ones(4, int), np.array([0, 0, 1, 1]), feet[:1] + 0.1, feet)
    assert [row["number"] for row in rows] == [1, 0] and rows[1]["iou"] == 0.0


@pytest.fixture
def row(tmp_path, monkeypatch):
    """Truth of a row of three whips, and results that are the truth in another frame."""
    monkeypatch.setattr(orchard_rows, "TRUTH_POINTS", 20_000)
    scene = orchard_rows.row_scene(52, n_trees=3)
    truth, results = tmp_path / "truth", tmp_path / "results"
    poses = orchard_rows.loop_poses(scene, 12)
    orchard_rows.write_row_truth(truth, scene, poses, "row")
    (results / "row").mkdir(parents=True)
    write_poses(results / "row" / "metric_poses.npz", poses.transformed(1.0, TURN, SHIFT))
    cloud = read_cloud(truth / "cloud.ply")
    write_cloud(results / "row" / "segmented.ply", cloud.transformed(1.0, TURN, SHIFT))
    owner = np.where(wood_mask(cloud["label"]), cloud["tree"].astype(np.int16) + 1, -1)
    write_npz(results / "row" / "owners.npz", owner=owner)
    true_trees = read_json(truth / "trees.json")["trees"]
    found = [{"foot": (TURN @ np.array(each["foot"]) + SHIFT).tolist()} for each in true_trees]
    write_json(results / "row" / "trees.json", {"trees": found, "left_out": []})
    for i, each in enumerate(true_trees):
        write_json(results / f"row_{i + 1}" / "traits.json", each["traits"])
        skeleton = read_skeleton_csv(truth / f"skeleton_tree{i}.csv")
        skeleton.points = skeleton.points @ TURN.T + SHIFT
        write_skeleton_graphml(results / f"row_{i + 1}" / "skeleton.graphml", skeleton)
    return results, truth


def test_the_truth_itself_is_right(row):
    results, truth = row
    assert len(read_poses(truth / "poses.npz").names) == 12
    report = measure_scanned_row(results, "row", truth)
    assert report["n_found"] == report["n_trees"] == 3
    assert report["totals"]["most_wrong"] == 0.0
    assert report["totals"]["least_iou"] > 0.99 and report["totals"]["trunk_mae_m"] < 1e-6
    assert min(each["skeleton_recall"] for each in report["trees"]) > 0.99
    assert report["cameras"]["scale_error"] < 1e-6


def test_a_tree_given_to_its_neighbour_and_a_thick_trunk_are_told(row):
    results, truth = row
    owner = np.load(results / "row" / "owners.npz")["owner"]
    owner[np.flatnonzero(owner == 1)[::2]] = 2
    write_npz(results / "row" / "owners.npz", owner=owner)
    traits = read_json(results / "row_3" / "traits.json")
    write_json(
        results / "row_3" / "traits.json",
        traits | {"trunk_diameter_m": traits["trunk_diameter_m"] + 0.012},
    )
    report = measure_scanned_row(results, "row", truth)
    assert report["totals"]["least_iou"] == report["trees"][0]["iou"]
    assert report["totals"]["most_wrong"] > 0.03
    assert report["totals"]["trunk_mae_m"] == pytest.approx(0.004, abs=1e-6)
    assert report["trees"][0]["iou"] == pytest.approx(0.5, abs=0.01)


def test_results_without_a_tree_are_refused(row):
    results, truth = row
    found = read_json(results / "row" / "trees.json")
    write_json(results / "row" / "trees.json", found | {"trees": []})
    with pytest.raises(StageError, match="no tree"):
        measure_scanned_row(results, "row", truth)
