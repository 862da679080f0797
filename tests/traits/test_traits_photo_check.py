"""What the photos say of a skeleton reaches the traits, their flags and the table of branches."""

import numpy as np
import pytest
from sound_tree import flags_of

from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.branches import branch_rows
from cherrypicker.traits.photo_diameters import with_photos
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
    return [flag.split(":")[0] for flag in flags_of(Reports(photo_check=check))]


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

    def measured(seen=range(20), **photo):
        widths = [0.0045 if node in seen else None for node in range(20)]
        each = {"branch_id": 0, "diameter": 0.0045, "widths": widths}
        check = {"branches": [each | photo]} if photo else None
        return branch_rows(skeleton, axes(skeleton), 0.0, photo_check=check)[0]

    return measured


def test_silhouettes_stand_in_the_table_and_count_as_much_as_they_are_sure(rows):
    points, sure, unsure = rows(), rows(diameter_se=0.0005), rows(diameter_se=0.05)
    assert (sure["photo_diameter_m"], sure["photo_diameter_se_m"]) == (0.0045, 0.0005)
    assert points["photo_diameter_m"] is None
    for name in ("base_diameter_m", "tip_diameter_m", "mean_diameter_m"):
        assert points[name] == pytest.approx(0.006)
        assert 0.0045 < sure[name] < 0.0051
        assert 0.0059 < unsure[name] < points[name]
    assert sure["volume_m3"] < 0.75 * points["volume_m3"]
    same = ("length_m", "insertion_angle_deg", "n_laterals")
    assert [sure[name] for name in same] == [points[name] for name in same]


def test_both_are_surer_than_the_points_and_less_so_where_the_photos_saw_nothing_near(rows):
    def width(row):
        return row["base_diameter_high_m"] - row["base_diameter_low_m"]

    seen = [rows(range(first, 20), diameter_se=0.0005) for first in (0, 5, 10, 15)]
    widths = [width(row) for row in (*seen, rows())]
    assert widths == sorted(widths)
    assert widths[0] < 0.7 * widths[-1]
    bases = [row["base_diameter_m"] for row in (*seen, rows())]
    assert bases == sorted(bases)


def test_what_the_photos_add_is_a_difference_not_a_share():
    """Of a stem that tapers from 20 to 4 mm photos see the upper half, 1.5 mm thinner."""
    stem = np.column_stack([np.zeros((20, 2)), np.linspace(0, 1, 20)])
    radius, fields = np.linspace(0.010, 0.002, 20), {"residual": np.full(20, 0.004)}
    skeleton = Skeleton(stem, np.arange(-1, 19), radius, np.full(20, 2), fields)
    told = [2 * r - 0.0015 if r < 0.006 else None for r in radius]
    check = [{"branch_id": 0, "diameter_se": 0.0002, "widths": told}]
    change = 2 * (with_photos(skeleton, axes(skeleton), check).radius - radius)
    assert change[-5:] == pytest.approx(-0.0015, abs=0.0003)  # a share would end at nothing
    assert (change > -0.0017).all() and (np.diff(change[:10]) < 0).all()
    assert abs(change[0]) < 0.0005


def test_what_scatter_adds_to_the_twigs_that_photos_see_is_taken_from_all_of_them():
    """A stem of 40 mm with ten twigs of 4 and 6 mm that the wind swells; photos see eight."""
    points, parent = [[0.0, 0.0, 0.1 * node] for node in range(12)], list(range(-1, 11))
    true = [0.02] * 12
    for twig in range(10):
        for step in range(5):
            parent.append(len(points) - 1 if step else 1 + twig)
            points.append([0.02 * (5 - twig / 2) * (1 + step), 0.0, 0.1 * (1 + twig)])
            true.append(0.002 if twig % 2 else 0.003)
    true = np.array(true)
    is_twig, swelling = true < 0.01, 4e-6
    radius = np.where(is_twig, np.sqrt(true**2 + swelling), true)
    fields = {"residual": np.full(len(true), 0.003)}
    skeleton = Skeleton(points, parent, radius, np.where(is_twig, 2, 1), fields)
    axis_list = axes(skeleton)
    twigs = [branch for branch, axis in enumerate(axis_list) if is_twig[axis.nodes].all()]
    assert len(twigs) == 10

    def measured(diameter_se):
        widths = {k: list(2 * true[axis_list[k].nodes]) for k in twigs[:8]}
        each = {"diameter_se": diameter_se}
        check = [each | {"branch_id": k, "widths": wide} for k, wide in widths.items()]
        return with_photos(skeleton, axis_list, check).radius

    found = measured(0.0002)
    assert found[is_twig] == pytest.approx(true[is_twig], rel=0.08)
    assert found[~is_twig] == pytest.approx(true[~is_twig], rel=1e-6)
    unseen = np.concatenate([axis_list[k].nodes for k in twigs[8:]])
    change = (radius - measured(0.004))[unseen]
    assert (change > 0).all() and (change < 0.5 * (radius - true)[unseen]).all()


@pytest.mark.parametrize("seen", [slice(0, 5), slice(15, 20)])
def test_wood_beyond_what_photos_saw_may_be_thinner_and_wood_below_it_is_not(seen):
    """Photos see the lower end of a stem that tapers from 20 to 2 mm, or its tip, 1 mm thicker."""
    stem = np.column_stack([np.zeros((20, 2)), np.linspace(0, 2, 20)])
    radius, fields = np.linspace(0.010, 0.001, 20), {"residual": np.full(20, 0.001)}
    skeleton = Skeleton(stem, np.arange(-1, 19), radius, np.full(20, 2), fields)
    told = np.full(20, None)
    told[seen] = 2 * radius[seen] + 0.001
    check = [{"branch_id": 0, "diameter_se": 0.0002, "widths": told.tolist()}]
    both = 2 * with_photos(skeleton, axes(skeleton), check).radius
    assert both == pytest.approx(2 * radius, abs=0.0012)
    assert (both >= 2 * radius[-1]).all()
    radius[5:15] = 1e-5  # of a gap in the points
    both = 2 * with_photos(skeleton, axes(skeleton), check).radius
    assert (both[5:15] < 0.002 if seen.start == 0 else both[5:15] >= told[-1]).all()


def test_tubes_that_nobody_knows_the_error_of_give_way_to_photos(rows):
    skeleton = Skeleton([[0, 0, 0], [0, 0, 1.0]], [-1, 0], [0.01, 0.01], [2, 2])
    check = [{"branch_id": 0, "diameter_se": 0.0005, "widths": [None, 0.012]}]
    both = with_photos(skeleton, axes(skeleton), check)
    assert 0.006 <= both.radius[1] < 0.009
    assert np.isfinite(both.fields["photo_error"]).all()
