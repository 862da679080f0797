"""Held-out measures: scans are judged by the nearest true surface, tables name every class."""

import json

import ablate_labels
import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker.pointcloud import PointCloud, write_cloud
from cherrypicker.poses import Poses, write_poses
from cherrypicker_lab.orchard.truth import GENERATOR_VERSION
from cherrypicker_lab.training.segmentation import held_out, scenes
from cherrypicker_lab.training.segmentation.augment import Sample


def _poses(centers):
    rotation = np.tile(np.eye(3), (len(centers), 1, 1))
    cam = np.concatenate([rotation, -np.asarray(centers, float)[:, :, None]], axis=2)
    n = len(centers)
    return Poses(
        np.array([f"{i}.jpg" for i in range(n)]),
        cam,
        np.tile(np.eye(3), (n, 1, 1)),
        np.full(n, 100),
        np.full(n, 100),
    )


def test_a_scan_is_moved_onto_its_scene_and_far_points_have_no_class(tmp_path):
    results, truth = tmp_path / "results" / "tree", tmp_path / "truth"
    results.mkdir(parents=True)
    truth.mkdir()
    centers = np.array([[0, 0, 1.0], [1, 0, 1], [0, 1, 1.2], [1, 1, 0.8]])
    shift = np.array([0.5, -0.2, 0.1])
    surface = np.array([[0, 0, 0], [0, 0, 1.0], [0.5, 0, 1]])
    labels = np.array([Label.GROUND, Label.TRUNK, Label.BRANCH], np.uint8)
    write_poses(truth / "poses.npz", _poses(centers))
    write_poses(results / "metric_poses.npz", _poses(centers + shift))
    write_cloud(truth / "cloud.ply", PointCloud(surface, fields={"label": labels}))
    found = np.vstack([surface + [0.01, 0, 0], [[2.0, 2, 2]]]) + shift
    write_cloud(results / "metric.ply", PointCloud(found))
    scan = held_out.of_scan(results, truth)
    assert scan.name == "tree"
    assert scan.truth.tolist() == [0, 1, 2, 255]
    assert scan.markers is None
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    solved = {"scale": 0.2, "markers": [{"corners": corners}]}
    solved |= {"other_markers": [], "unsolved_markers": []}
    (results / "scale.json").write_text(json.dumps(solved))
    (results / "align.json").write_text(json.dumps({"transform": np.eye(4).tolist()}))
    known = held_out.of_scan(results, truth).markers
    assert known.squares == pytest.approx(0.2 * np.array([corners]))


def test_the_table_has_a_row_a_set_and_leaves_absent_classes_open():
    confusion = np.zeros((7, 7), np.int64)
    confusion[0, 0], confusion[1, 1], confusion[1, 2], confusion[2, 2] = 10, 6, 2, 8
    lines = held_out.table({"one": confusion}).splitlines()
    assert len(lines) == 3
    cells = [cell.strip() for cell in lines[2].strip("|").split("|")]
    assert cells == ["one", "0.850", "1.000", "0.857", "0.889", "-", "-", "-", "-"]


def test_a_generated_sample_has_its_colours():
    sample = Sample(
        np.zeros((5, 3), np.float32), np.full((5, 3), 255, np.uint8), np.ones(5, np.uint8), None
    )
    assert held_out.of_sample("a", sample).cloud.colors.max() == pytest.approx(1.0)


def test_scenes_are_kept_to_a_quarter_of_a_millimetre(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    points = rng.uniform(-3, 3, (50, 3)).astype(np.float32)
    made = Sample(
        points,
        rng.integers(0, 256, (50, 3), np.uint8),
        rng.integers(0, 7, 50).astype(np.uint8),
        np.zeros(50, np.uint8),
    )
    calls = []

    def make(seed, n_points, *, habit=None, things, skeletons):
        assert things == "common" and not skeletons
        calls.append((seed, habit))
        return made

    monkeypatch.setattr(scenes, "make_sample", make)
    for _ in range(2):
        loaded = scenes.load_samples([4, 5], tmp_path, 1000, habits=("vase", None))
    assert calls == [(4, "vase"), (5, None)]  # the second time they come from the folder
    assert (tmp_path / f"scene_v{GENERATOR_VERSION}_vase_000004_1000.npz").is_file()
    assert np.abs(loaded[0].points - points).max() <= 0.5 * scenes.QUANTUM_M + 1e-6
    assert np.array_equal(loaded[1].labels, made.labels)


def test_every_pass_that_can_be_turned_off_stands_in_its_module():
    for module, name, instead in ablate_labels.PASSES.values():
        assert callable(getattr(module, name)) and callable(instead), name
