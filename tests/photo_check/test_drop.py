"""What is more likely not there is dropped with all that hangs on it, and wood beyond stays."""

import numpy as np
import pytest
from checked_scene import STEM, TWIGS, open_scan, skeleton_of
from sky_scene import BARK, Rod

from cherrypicker.photo_check.drop import _kept, drop_refuted
from cherrypicker.photo_check.places import places_along
from cherrypicker.skeleton.model import Skeleton


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return open_scan(tmp_path_factory.mktemp("scan"))


def test_nothing_of_the_true_skeleton_is_dropped(scan):
    skeleton = skeleton_of((STEM, *TWIGS))
    left, report = drop_refuted(skeleton, scan, skeleton.points)
    assert len(left) == len(skeleton)
    assert report["pieces"] == [] and report["dropped_length"] == 0.0
    assert report["expected_length"] == pytest.approx(report["length"], rel=0.01)


def test_a_strand_is_dropped_and_kept_on_record(scan):
    strand = Rod((0.0, 0.0, 1.2), (-0.14, -0.11, 1.31), 0.002, BARK)
    whole = skeleton_of((STEM, *TWIGS))
    spoilt = skeleton_of((STEM, *TWIGS, strand))
    left, report = drop_refuted(spoilt, scan, spoilt.points)
    assert np.abs(left.points[len(whole) :, :2]).max(initial=0.0) < 0.03
    assert (left.points[: len(whole)] == whole.points).all()
    (piece,) = report["pieces"]
    length = np.linalg.norm(np.subtract(strand.end, strand.start))
    assert piece["length"] == pytest.approx(length, rel=0.1)
    assert piece["n_photos"] > 4 and piece["p_exists"] < 0.1
    edges = np.array(piece["edges"])
    steps = np.linalg.norm(edges[:, 3:6] - edges[:, :3], axis=1)
    assert steps.sum() == pytest.approx(piece["length"], abs=1e-4)
    assert edges[-1, 3:6] == pytest.approx(strand.end)


@pytest.mark.parametrize("n_air, is_kept", [(2, True), (5, False)])
def test_a_bridge_goes_only_with_less_wood_beyond(n_air, is_kept):
    points = np.zeros((20, 3))
    points[:, 2] = 0.01 * np.arange(20)
    chain = Skeleton(points, np.arange(-1, 19), np.full(20, 0.002), np.full(20, 2))
    places = places_along(chain, 0.01)
    air = (places.node >= 16 - n_air) & (places.node < 16)  # four nodes of wood beyond
    kept = _kept(chain, places, np.where(air, 0.01, 0.99))
    assert kept[: 16 - n_air].all()
    assert (kept[16 - n_air :] == is_kept).all()
