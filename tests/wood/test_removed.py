"""Every point that a stage took out is told with its cause, and no other is."""

import numpy as np
import pytest

from cherrypicker.classes import Label, Removal
from cherrypicker.errors import StageError
from cherrypicker.pointcloud import PointCloud, read_cloud, write_cloud
from cherrypicker.wood.removed import Earlier, read_removed_by, removed_points


def test_each_point_that_went_has_its_cause_and_stands_in_metres():
    rng = np.random.default_rng(0)
    before = rng.random((10, 3)).astype(np.float32).astype(np.float64)
    aligned = PointCloud(before, colors=rng.random((10, 3)))
    cropped = aligned.select(np.arange(1, 10))
    by = np.zeros(9, np.uint8)
    by[[0, 4]] = Removal.ISOLATED, Removal.SKY
    left = cropped.select(by == 0)
    labels = np.array([Label.TRUNK, Label.BRANCH, Label.BRANCH, Label.GROUND, Label.BRANCH] * 2)[:7]
    segmented = PointCloud(
        0.5 * left.points, left.colors, fields={"label": labels.astype(np.uint8)}
    )
    owner = np.array([2, 2, 1, -1, -1, 2, 2])
    removed = removed_points(segmented, owner, 2, Earlier(aligned, cropped, by, 0.5))
    expected = {
        Removal.OTHER_TREE: segmented.points[[2]],
        Removal.LOOSE: segmented.points[[4]],
        Removal.REGION: 0.5 * before[:1],
        Removal.ISOLATED: 0.5 * cropped.points[[0]],
        Removal.SKY: 0.5 * cropped.points[[4]],
    }
    assert len(removed) == len(expected) and removed.colors is not None
    for reason, points in expected.items():
        np.testing.assert_allclose(removed.points[removed["removed_by"] == reason], points)


def test_a_ready_cloud_loses_wood_alone_or_nothing(tmp_path):
    labels = np.array([Label.TRUNK, Label.SIGN, Label.BRANCH], np.uint8)
    cloud = PointCloud(np.eye(3), fields={"label": labels})
    removed = removed_points(cloud, np.array([0, -1, -1]), 0)
    assert removed["removed_by"].tolist() == [Removal.LOOSE]
    nothing = removed_points(cloud, np.array([0, -1, 0]), 0)
    write_cloud(tmp_path / "removed.ply", nothing, may_be_empty=True)
    back = read_cloud(tmp_path / "removed.ply", ("removed_by",), may_be_empty=True)
    assert len(back) == 0


def test_what_denoising_took_out_of_another_cloud_is_refused_by_name(tmp_path):
    np.savez(tmp_path / "denoise.npz", removed_by=np.zeros(4, np.uint8))
    assert not read_removed_by(tmp_path / "denoise.npz", PointCloud(np.zeros((4, 3)))).any()
    with pytest.raises(StageError, match=r"tells of 4 points, .* has 3; .*denoise\.npz"):
        read_removed_by(tmp_path / "denoise.npz", PointCloud(np.zeros((3, 3))))
