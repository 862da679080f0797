"""What the photos refute is dropped with all that hangs on it, and wood beyond stays."""

import numpy as np
import pytest
from checked_scene import STEM, TWIGS, open_scan, skeleton_of
from sky_scene import BARK, Rod

from cherrypicker.photo_check.drop import _kept, drop_refuted
from cherrypicker.photo_check.places import places_along
from cherrypicker.photo_check.votes import Votes, stands_out
from cherrypicker.skeleton.model import Skeleton


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return open_scan(tmp_path_factory.mktemp("scan"))


def test_nothing_of_the_true_skeleton_is_dropped(scan):
    skeleton = skeleton_of((STEM, *TWIGS))
    left, report = drop_refuted(skeleton, *scan, 2)
    assert len(left) == len(skeleton)
    assert report["pieces"] == [] and report["dropped_length"] == 0.0


def test_a_strand_is_dropped_and_kept_on_record(scan):
    strand = Rod((0.0, 0.0, 1.2), (-0.14, -0.11, 1.31), 0.002, BARK)
    whole = skeleton_of((STEM, *TWIGS))
    left, report = drop_refuted(skeleton_of((STEM, *TWIGS, strand)), *scan, 2)
    assert np.abs(left.points[len(whole) :, :2]).max(initial=0.0) < 0.03
    assert (left.points[: len(whole)] == whole.points).all()
    (piece,) = report["pieces"]
    length = np.linalg.norm(np.subtract(strand.end, strand.start))
    assert piece["length"] == pytest.approx(length, rel=0.1)
    assert piece["n_photos"] > 4
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
    kept = _kept(chain, places, air)
    assert kept[: 16 - n_air].all()
    assert (kept[16 - n_air :] == is_kept).all()


def test_photos_that_refute_most_of_a_tree_are_not_believed():
    points = np.zeros((20, 3))
    points[:, 2] = 0.01 * np.arange(20)
    chain = Skeleton(points, np.arange(-1, 19), np.full(20, 0.002), np.full(20, 2))
    places = places_along(chain, 0.01)
    assert _kept(chain, places, places.node > 5).all()


def test_what_wind_moves_in_single_photos_does_not_stand_out():
    rng = np.random.default_rng(0)
    n_photos, n_places = 40, 500
    sway = np.full(n_places, 0.15)
    sway[:20] = 0.6  # a strand
    clear = rng.random((n_photos, n_places)) < sway
    refuted = stands_out(Votes(clear, ~clear), np.full(n_places, 0.002), 2)
    assert refuted[:20].all()
    assert refuted[20:].mean() < 0.02
    assert (clear.sum(axis=0) >= 2).mean() > 0.95


def test_in_a_still_scan_two_photos_are_enough():
    clear = np.zeros((40, 500), dtype=bool)
    clear[:2, :20] = True
    refuted = stands_out(Votes(clear, ~clear), np.full(500, 0.002), 2)
    assert refuted.tolist() == [True] * 20 + [False] * 480
