"""Volumes, taper, shoots and crowns of shapes whose answers are known."""

import numpy as np
import pytest

from cherrypicker.geometry.hulls import alpha_volume, hull_of
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.branches import branch_rows, branches_csv
from cherrypicker.traits.support import missed_wood, owning_nodes


@pytest.fixture
def rows():
    """A stem of 1 m, 6 cm thick at the foot and 4 cm at the top; cylinders of 2 cm hang on it."""
    z = np.arange(101) / 100
    stem = np.column_stack([np.zeros(101), np.zeros(101), z])
    points, parent, radius = [stem], [np.arange(-1, 100)], [0.03 - 0.01 * z]
    x = np.arange(1, 31) / 100
    for number, foot in enumerate((40, 60, 85)):
        points.append(np.column_stack([x, np.zeros(30), np.full(30, z[foot])]))
        first = 101 + 30 * number
        parent.append(np.concatenate([[foot], np.arange(first, first + 29)]))
        radius.append(np.full(30, 0.01))
    n = sum(map(len, points))
    fields = {"arc_deg": np.full(n, 300.0), "n_points": np.full(n, 50), "gap": np.zeros(n, int)}
    fields["arc_deg"][131:161] = 90.0
    fields["gap"][170:190] = 1
    skeleton = Skeleton(
        np.vstack(points),
        np.concatenate(parent),
        np.concatenate(radius),
        np.ones(n, dtype=int),
        fields,
    )
    return branch_rows(skeleton, axes(skeleton), 0.0)


def test_volume_taper_and_mean_diameter(rows):
    stem, side = rows[0], rows[1]
    cone = np.pi / 3 * (0.03**2 + 0.03 * 0.02 + 0.02**2)
    assert stem["volume_m3"] == pytest.approx(cone, rel=1e-4)
    assert stem["taper_mm_per_m"] == pytest.approx(20.0)
    assert stem["mean_diameter_m"] == pytest.approx(0.05)
    assert side["volume_m3"] == pytest.approx(np.pi * 0.01**2 * 0.3)
    assert side["taper_mm_per_m"] == pytest.approx(0.0, abs=1e-9)


def test_laterals_and_shoots(rows):
    assert rows[0]["n_laterals"] == 3
    assert rows[0]["lateral_spacing_m"] == pytest.approx((0.20 + 0.25) / 2)
    assert rows[0]["shoot_length_m"] == pytest.approx(0.15)
    assert rows[1]["n_laterals"] == 0 and rows[1]["lateral_spacing_m"] is None
    assert rows[1]["shoot_length_m"] == pytest.approx(0.3)


def test_what_rests_on_little_is_flagged(rows):
    assert [row["flags"] for row in rows] == ["", "", "low_arc", "gap"]
    assert rows[3]["gap_share"] == pytest.approx(20 / 30)
    lines = branches_csv(rows).splitlines()
    assert lines[0].endswith(",base_height_m,mean_diameter_m,taper_mm_per_m,volume_m3,"
                             "n_laterals,lateral_spacing_m,shoot_length_m,base_arc_deg,"
                             "base_n_points,gap_share,flags,base_diameter_low_m,base_diameter_high_m,"
                             "insertion_angle_low_deg,insertion_angle_high_deg,"
                             "photo_diameter_m,photo_diameter_se_m,p_exists")  # fmt: skip
    assert ",,0.30000," in lines[2]  # no spacing is an empty cell


def test_crown_of_two_cubes_is_not_what_lies_between():
    rng = np.random.default_rng(2)
    cube = rng.random((6000, 3))
    cubes = np.vstack([cube, cube + [3.0, 0, 0]])
    assert alpha_volume(cubes, 0.3, 0.01) == pytest.approx(2.0, rel=0.1)
    assert alpha_volume(cubes, 100.0, 0.01) == pytest.approx(4.0, rel=0.05)
    assert hull_of(cubes[:, :2]).volume == pytest.approx(4.0, rel=0.05)
    assert alpha_volume(np.zeros((10, 3)), 1.0, 0.1) == 0.0
    assert hull_of(np.zeros((10, 2))).volume == 0.0


def test_wood_without_an_axis_is_counted_where_it_touches_the_tree():
    rng = np.random.default_rng(5)
    stem = np.column_stack([rng.normal(0, 0.004, (900, 2)), rng.uniform(0, 1, 900)])
    shoot = np.column_stack([rng.uniform(0.0, 0.3, 100), rng.normal(0, 0.004, (100, 2)) + [0, 0.5]])
    other = np.array([0.8, 0, 0.5]) + rng.normal(0, 0.02, (200, 3))
    wood = np.vstack([stem, shoot, other])
    away = np.hypot(wood[:, 0], wood[:, 1])
    missed, length = missed_wood(wood[away > 0.05], wood[away < 0.05], 0.03)
    assert len(missed) == np.count_nonzero(away[900:1000] > 0.05)
    assert length == pytest.approx(0.25, abs=0.04)
    np.testing.assert_allclose([missed[:, 0].min(), missed[:, 0].max()], [0.05, 0.3], atol=0.02)
    assert len(missed_wood(wood[:0], wood[:900], 0.03)[0]) == 0


def test_a_largest_radius_whose_square_rounds_down_has_a_place():
    """Squared alone it was less than in an array, by one digit in some trees of two thousand."""
    thickest = 0.07541889597278378
    skeleton = Skeleton([[0, 0, 0], [0, 0, 1.0]], [-1, 0], [thickest, thickest / 2], [1, 1])
    _, away, thick = owning_nodes(np.array([[0.1, 0.0, 0.0]]), skeleton)
    assert away == pytest.approx([0.1]) and thick == pytest.approx([thickest])
