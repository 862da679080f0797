"""A scan spoilt on purpose: what is taken and put, and that its photos tell it every time."""

import numpy as np
import pytest
from checked_scene import STEM, TWIGS, open_scan, skeleton_of
from scipy.spatial import cKDTree
from sound_tree import flags_of

from cherrypicker.classes import Label
from cherrypicker.photo_check.check import check_photos
from cherrypicker.pointcloud import PointCloud
from cherrypicker.traits.reports import Reports
from cherrypicker_lab.spoilt_skeletons import APART_M, LEAVES_M, SIZES, spoil

SPOILT = [
    *(("top cut off, to", size) for size in (0.85, 0.7, 0.5)),
    *(("limb removed, m", size) for size in (0.2, 0.3)),
    *(("strand added, m", size) for size in (0.2, 0.3)),
]


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return open_scan(tmp_path_factory.mktemp("scan"))


@pytest.fixture(scope="module")
def finished():
    skeleton = skeleton_of((STEM, *TWIGS))
    label = np.full(len(skeleton), Label.BRANCH, np.uint8)
    return skeleton, PointCloud(skeleton.points.copy(), fields={"label": label})


@pytest.mark.parametrize("kind, size", SPOILT)
def test_what_is_taken_and_put(finished, kind, size):
    skeleton, cloud = finished
    spoilt = spoil(skeleton, cloud, kind, size)
    before, after = (s.edge_length.sum() for s in (skeleton, spoilt.skeleton))
    if kind.startswith("strand"):
        assert after - before == pytest.approx(size) == spoilt.length
        beyond = cKDTree(skeleton.points).query(spoilt.added)[0]
        assert (beyond[round(LEAVES_M / 0.01) :] > APART_M - 0.01).all()
        assert len(spoilt.cloud) == len(cloud) + len(spoilt.added)
    else:
        assert before - after == pytest.approx(spoilt.length)
        assert not len(spoilt.added)
        assert cKDTree(spoilt.cloud.points).query(spoilt.missing)[0].max() > 0.05
        assert len(spoilt.cloud) == len(spoilt.skeleton)


def test_strands_are_put_up_to_a_share_of_the_length(finished, monkeypatch):
    skeleton, cloud = finished
    monkeypatch.setitem(SIZES, "strand added, m", (0.2, 0.3))  # a small tree
    spoilt = spoil(skeleton, cloud, "strands added, of the length", 0.08)
    longer = spoilt.skeleton.edge_length.sum() - skeleton.edge_length.sum()
    assert longer == pytest.approx(spoilt.length) == 0.01 * len(spoilt.added)
    assert spoilt.length >= 0.08 * skeleton.edge_length.sum()


@pytest.mark.parametrize("kind, size", SPOILT)
def test_the_photos_tell_it_every_time(scan, finished, kind, size):
    spoilt = spoil(*finished, kind, size)
    report, _ = check_photos(
        spoilt.skeleton, spoilt.cloud, scan, finished[1].points, other_stems=np.empty((0, 2))
    )
    flags = [flag.partition(":")[0] for flag in flags_of(Reports(photo_check=report))]
    assert flags == ["not_in_photos" if kind.startswith("strand") else "wood_missing"]
    if spoilt.length and not kind.startswith("strand"):
        assert report["missing_from_cloud_length"] > 0.5 * report["missing_length"]
