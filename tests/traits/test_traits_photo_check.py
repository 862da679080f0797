"""What the photos say of a skeleton reaches the traits, their flags and the table of branches."""

import numpy as np
import pytest

from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.branches import branch_rows
from cherrypicker.traits.flags import quality_flags
from cherrypicker.traits.reports import Reports

GOOD = {
    "photo_precision": 0.99,
    "photo_recall": 0.98,
    "photo_sky_share": 0.8,
    "n_photos": 40,
    "photo_confirmed": 0.78,
    "length": 50.0,
    "judged_length": 40.0,
    "unseen_length": 0.5,
    "refuted_length": 0.4,
    "missing_length": 0.3,
    "refuted_pieces": [{"length": 0.1, "at": [0, 0, 1]}],
    "missing_pieces": [],
}


def names(check):
    return [flag.split(":")[0] for flag in quality_flags(Reports(photo_check=check))]


def test_a_skeleton_that_the_photos_confirm_has_no_flag():
    assert names(GOOD) == names({}) == []


@pytest.mark.parametrize(
    "change, flag",
    [
        ({"photo_precision": 0.94}, "not_in_photos"),
        ({"refuted_pieces": [{"length": 0.3, "at": [0, 0, 1]}]}, "not_in_photos"),
        ({"photo_recall": 0.9}, "wood_missing"),
        ({"missing_pieces": [{"length": 0.2, "at": [0, 0, 1]}]}, "wood_missing"),
    ],
)
def test_a_small_share_or_a_long_piece_is_flagged(change, flag):
    assert names(GOOD | change) == [flag]


@pytest.mark.parametrize(
    "total, longest, is_told", [(0.0, 0.0, 0), (0.1, 0.1, 0), (2.5, 0.1, 1), (0.3, 0.3, 1)]
)
def test_what_was_dropped_is_told_where_it_is_much(total, longest, is_told):
    before = {
        "photo_precision": 0.9,  # what is refuted and left is told by another flag
        "length": 40.0,
        "dropped_length": total,
        "dropped_pieces": [{"length": longest, "at": [0, 0, 1]}],
    }
    assert names(GOOD | {"before": before}) == ["dropped_by_photos"] * is_told


@pytest.fixture
def rows():
    stem = np.column_stack([np.zeros((20, 2)), np.linspace(0, 1, 20)])
    fields = {"residual": np.full(20, 0.004), "n_points": np.full(20, 25)}
    parent = np.arange(-1, 19)
    skeleton = Skeleton(stem, parent, np.full(20, 0.003), np.full(20, 2), fields)

    def measured(**photo):
        each = {"branch_id": 0, "diameter": 0.0045, "tube_diameter": 0.006, "length": 1.0}
        check = {"branches": [each | photo]} if photo else None
        return branch_rows(skeleton, axes(skeleton), 0.0, photo_check=check)[0]

    return measured


def test_silhouettes_stand_in_the_table_where_they_are_surer(rows):
    sure, unsure = rows(diameter_se=0.0005), rows(diameter_se=0.05)
    assert (sure["photo_diameter_m"], sure["photo_diameter_se_m"]) == (0.0045, 0.0005)
    assert unsure["photo_diameter_m"] is None
    assert unsure == rows()


def test_what_the_photos_did_not_measure_has_the_error_of_the_points(rows):
    widths = []
    for length in (1.0, 0.5, 0.1):
        row = rows(diameter_se=0.0005, length=length)
        widths.append(row["base_diameter_high_m"] - row["base_diameter_low_m"])
    points = rows()
    widths.append(points["base_diameter_high_m"] - points["base_diameter_low_m"])
    assert widths == sorted(widths)
    assert rows(diameter_se=0.0005, length=0.0) == points


def test_a_surer_silhouette_scales_what_the_points_say(rows):
    points, photos = rows(), rows(diameter_se=0.0005)
    for name in ("base_diameter_m", "tip_diameter_m", "mean_diameter_m"):
        assert points[name] == pytest.approx(0.006)
        assert photos[name] == pytest.approx(0.0045)
    assert photos["volume_m3"] == pytest.approx(points["volume_m3"] * 0.75**2)
    ends = [photos[f"base_diameter_{end}_m"] for end in ("low", "high")]
    assert ends == pytest.approx([0.0045 - 1.645 * 0.0005, 0.0045 + 1.645 * 0.0005])
    same = ("length_m", "insertion_angle_deg", "insertion_angle_low_deg", "n_laterals")
    assert [photos[name] for name in same] == [points[name] for name in same]
