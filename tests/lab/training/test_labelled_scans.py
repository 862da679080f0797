"""Scans that a user labelled train beside generated scenes; what is wrong with one is named."""

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.pointcloud import PointCloud, write_cloud
from cherrypicker_lab.training.segmentation.random_props import NO_WOOD
from cherrypicker_lab.training.segmentation.scans import load_scans
from cherrypicker_lab.training.segmentation.training import IGNORED, network_labels

FAR = np.array([4.5e5, 5.2e6, 300.0])  # map coordinates


def _table(folder, *names):
    table = folder / "scans.tsv"
    table.write_text("\n".join(["cloud\tnote", *(f"{folder / name}\tmine" for name in names)]))
    return table


def _scan(path, labels, colors=True, field="label"):
    labels = np.asarray(labels)
    rng = np.random.default_rng(1)
    points = FAR + np.round(rng.uniform(-1, 1, (len(labels), 3)), 3)
    kept = rng.integers(0, 256, points.shape) / 255.0 if colors else None
    write_cloud(path, PointCloud(points, colors=kept, fields={field: labels}))
    return points, kept


def test_scans_keep_their_shape_colours_and_labels(tmp_path):
    labels = np.array([0, 1, 2, 7, 255, NO_WOOD], np.uint8)
    points, colors = _scan(tmp_path / "a.ply", labels)
    _scan(tmp_path / "b.ply", labels.astype(np.float32), colors=False, field="scalar_label")
    first, second = load_scans(_table(tmp_path, "a.ply", "b.ply"))
    apart = np.diff(first.points.astype(float), axis=0) - np.diff(points, axis=0)
    assert np.abs(apart).max() < 1e-5 and np.abs(first.points).max() < 4
    assert np.allclose(first.colors / 255.0, colors, atol=1e-6) and second.colors is None
    assert first.labels.tolist() == second.labels.tolist() == labels.tolist()
    assert first.trees.tolist() == [255, 0, 0, 255, 255, 255]
    targets = network_labels(first.labels)
    assert targets[3] == Label.SUPPORT_POST.channel and targets[4] == IGNORED


@pytest.mark.parametrize(
    ("labels", "cause"),
    [([0, 1, 9], "no class has the label 9"), ([255, 255, 255], "no point has a label")],
)
def test_a_scan_that_cannot_be_used_names_file_row_and_key(tmp_path, labels, cause):
    _scan(tmp_path / "good.ply", np.array([0, 1, 2], np.uint8))
    _scan(tmp_path / "bad.ply", np.array(labels, np.uint8))
    with pytest.raises(StageError, match=cause) as caught:
        load_scans(_table(tmp_path, "good.ply", "bad.ply"))
    assert "bad.ply" in str(caught.value)
    assert "train_segment.scans, line 3 of" in str(caught.value)


def test_a_scan_without_labels_and_a_table_that_is_none_are_errors(tmp_path):
    write_cloud(tmp_path / "bare.ply", PointCloud(np.zeros((3, 3))))
    with pytest.raises(StageError, match="has no label.*bare.ply.*train_segment.scans, line 2"):
        load_scans(_table(tmp_path, "bare.ply"))
    (tmp_path / "empty.tsv").write_text("scan\n")
    with pytest.raises(StageError, match="no cloud in the table.*train_segment.scans"):
        load_scans(tmp_path / "empty.tsv")
