"""What the photos say of a skeleton reaches the traits, their flags and the table of branches."""

import numpy as np
import pytest

from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.branches import branch_rows
from cherrypicker.traits.flags import scan_flags
from cherrypicker.traits.measure import _photo_shares

GOOD = {
    "photo_precision": 0.99,
    "photo_recall": 0.98,
    "photo_sky_share": 0.8,
    "n_photos": 40,
    "judged_length": 40.0,
    "refuted_length": 0.4,
    "missing_length": 0.3,
    "refuted_pieces": [{"length": 0.1, "at": [0, 0, 1]}],
    "missing_pieces": [],
}


def names(check):
    return [flag.split(":")[0] for flag in scan_flags("m", photo_check=check)]


def test_a_skeleton_that_the_photos_confirm_has_no_flag():
    assert names(GOOD) == names(None) == []
    assert _photo_shares(GOOD).keys() < GOOD.keys()
    assert _photo_shares(None) == {}


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


def test_silhouettes_stand_in_the_table_where_they_are_surer():
    stem = np.column_stack([np.zeros((20, 2)), np.linspace(0, 1, 20)])
    fields = {"residual": np.full(20, 0.004), "n_points": np.full(20, 25)}
    parent = np.arange(-1, 19)
    skeleton = Skeleton(stem, parent, np.full(20, 0.003), np.full(20, 2), fields)
    (sure, unsure) = (
        branch_rows(skeleton, axes(skeleton), 0.0, photo_check={"branches": [each]})[0]
        for each in (
            {"branch_id": 0, "diameter": 0.0045, "diameter_se": 0.0005},
            {"branch_id": 0, "diameter": 0.0045, "diameter_se": 0.05},
        )
    )
    assert (sure["photo_diameter_m"], sure["photo_diameter_se_m"]) == (0.0045, 0.0005)
    assert unsure["photo_diameter_m"] is None
    assert branch_rows(skeleton, axes(skeleton), 0.0)[0]["photo_diameter_m"] is None
