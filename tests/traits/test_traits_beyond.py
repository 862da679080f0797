"""Wood that is known to be missing widens intervals upwards, and values become the least."""

import numpy as np
import pytest
from sound_tree import flags_of

from cherrypicker.evidence.missing_top import MissingTop
from cherrypicker.geometry.hulls import hull_of
from cherrypicker.traits.crown import grown, growth_by, missing_wood
from cherrypicker.traits.flags import FLAGS, at_least
from cherrypicker.traits.reports import Reports
from cherrypicker.traits.table import TRAITS

NONE, FOOT = np.empty((0, 3)), np.array([0.1, 0.2, -0.5])
CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (1.0, 2.0)])


def extent_and_hull():
    hull = hull_of(CORNERS)
    return np.array([2.0, *grown(hull, NONE)]), hull


def test_nothing_missing_adds_nothing():
    none = missing_wood(NONE, Reports(), None, FOOT)
    assert none.shape == (0, 3)
    assert growth_by(none, *extent_and_hull()).tolist() == [0.0, 0.0, 0.0]


def test_wood_within_the_crown_adds_nothing_and_wood_beyond_does():
    piece = {"length": 0.2, "low": [0.2, 0.2, 1.2], "high": [0.4, 0.3, 1.5]}
    inside = Reports(photo_check={"missing_pieces": [piece]})
    assert growth_by(missing_wood(NONE, inside, None, FOOT), *extent_and_hull()) == pytest.approx(
        [0.0, 0.0, 0.0]
    )
    left_out = np.array([[0.5, 0.5, 1.5], [0.6, 0.6, 2.3]])
    missing = missing_wood(left_out, inside, None, FOOT)
    top, width, volume = growth_by(missing, *extent_and_hull())
    assert (top, width) == (pytest.approx(0.3), 0.0)
    assert 0.09 < volume < 0.15
    beside = np.array([[1.0, 0.0, 1.0], [3.0, 0.1, 1.1]])
    assert growth_by(missing_wood(beside, Reports(), None, FOOT), *extent_and_hull())[1] > 0.5


def test_a_loose_piece_of_the_cloud_counts_as_missing():
    loose = {"loose": [{"low": [0.5, 0.5, 2.1], "high": [0.6, 0.6, 2.3], "n_points": 30}]}
    missing = missing_wood(NONE, Reports(target=loose), None, FOOT)
    assert growth_by(missing, *extent_and_hull())[0] == pytest.approx(0.3)
    loose["loose"][0]["gap"] = 0.4
    (flag,) = flags_of(Reports(target=loose))
    assert flag.startswith("wood_loose") and "0.40 off" in flag
    assert "total_length_m" in at_least([flag])


def test_a_top_that_the_photos_show_counts_from_the_foot():
    shown = missing_wood(NONE, Reports(), MissingTop(2.9, 2.5, 12), FOOT)
    assert shown.tolist() == [[0.1, 0.2, pytest.approx(2.45)]]  # 2.9 - 0.5, and a voxel of 5 cm
    assert growth_by(shown, *extent_and_hull())[0] == pytest.approx(0.45)
    assert growth_by(shown, np.array([2.0, 0, 0]), hull_of(NONE)) == pytest.approx([0.45, 0, 0])


def test_flags_tell_which_values_are_the_least():
    assert at_least(["unscaled: no scale", "low_arc: few"]) == []
    assert at_least(["side_outside_photos: towards azimuth 270 degrees"]) == [
        "crown_volume_m3", "crown_width_m",
        "n_shoots", "n_tips", "total_length_m", "wood_volume_m3",
    ]  # fmt: skip
    assert "height_m" in at_least(["no_ground: no ground below the stem"])
    assert {name for flag in FLAGS.values() for name in flag.least} <= TRAITS.keys()
