"""Intervals of the traits, on trees and numbers with known answers."""

import csv
import io

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits import branch_rows, branches_csv, find_foot
from cherrypicker.traits.branch_intervals import angle_interval, diameter_interval
from cherrypicker.traits.crown import measure_crown
from cherrypicker.traits.trunk import Stem, measure_diameter


def stem_and_branch(residual=None):
    """A stem of 1 m and a branch of 0.5 m at right angles to it."""
    stem = np.column_stack([np.zeros((51, 2)), np.linspace(0, 1, 51)])
    branch = np.column_stack([np.linspace(0.02, 0.5, 25), np.zeros(25), np.full(25, 0.6)])
    parent = [-1, *range(50), 30, *range(51, 75)]
    radius = np.concatenate([np.full(51, 0.02), np.full(25, 0.01)])
    n = len(parent)
    fields = {"n_points": np.full(n, 25), "arc_deg": np.full(n, 300.0)}
    if residual is not None:
        fields["residual"] = np.asarray(residual, dtype=float)
    return Skeleton(np.vstack([stem, branch]), parent, radius, np.full(n, 1), fields)


def branch_row(skeleton, **options):
    return branch_rows(skeleton, axes(skeleton), 0.0, **options)[1]


def test_diameter_interval():
    low, high = diameter_interval(0.020, 0.001)
    half = 1.645e-3 * np.hypot(0.8, 0.25)
    assert (low, high) == pytest.approx((0.020 - half, 0.020 + half))
    low, high = diameter_interval(0.100, 1e-9, scale_error=0.01)
    assert (low, high) == pytest.approx((0.098355, 0.101645))
    assert diameter_interval(0.004, 0.004)[0] == 0.0


def test_thin_branches_are_less_sure_than_thick_ones():
    thin, thick = (np.ptp(diameter_interval(d, 0.002)) for d in (0.006, 0.060))
    assert thick == pytest.approx(2 * 1.645 * 0.8 * 0.002, rel=0.03)
    assert thin > 1.5 * thick


def test_angle_interval():
    low, high = angle_interval(60.0, 0.002, 25, 0.08)
    half = 1.645 * np.hypot(1.6, 10 * np.degrees(0.002 / (0.08 * 5)))
    assert (low, high) == pytest.approx((60 - half, 60 + half))
    assert angle_interval(1.0, 0.002, 25, 0.08)[0] == 0.0
    assert angle_interval(179.0, 0.002, 25, 0.08)[1] == 180.0
    few, many = (np.ptp(angle_interval(60.0, 0.002, n, 0.08)) for n in (4, 100))
    assert few > 2 * many


def test_columns_of_a_branch():
    row = branch_row(stem_and_branch(residual=np.full(76, 0.001)))
    assert row["base_diameter_m"] == pytest.approx(0.020)
    assert row["insertion_angle_deg"] == pytest.approx(90.0)
    expected = diameter_interval(0.020, 0.001)
    assert (row["base_diameter_low_m"], row["base_diameter_high_m"]) == pytest.approx(expected)
    expected = angle_interval(90.0, 0.001, 25, 0.08)
    found = (row["insertion_angle_low_deg"], row["insertion_angle_high_deg"])
    assert found == pytest.approx(expected)
    loose = branch_row(stem_and_branch(residual=np.full(76, 0.001)), scale_error=0.2)
    assert loose["base_diameter_high_m"] > 0.020 + 1.6 * 0.2 * 0.020
    assert loose["insertion_angle_high_deg"] == row["insertion_angle_high_deg"]


def test_a_branch_without_a_fit_takes_the_typical_scatter():
    residual = np.full(76, 0.001)
    residual[51:] = 0.0
    row = branch_row(stem_and_branch(residual))
    assert row["base_diameter_high_m"] == pytest.approx(diameter_interval(0.020, 0.001)[1])


def test_no_scatter_no_interval():
    skeleton = stem_and_branch()
    rows = branch_rows(skeleton, axes(skeleton), 0.0)
    assert rows[1]["base_diameter_low_m"] is None
    table = list(csv.DictReader(io.StringIO(branches_csv(rows))))
    assert table[1]["insertion_angle_high_deg"] == ""


def test_the_foot_is_as_unsure_as_the_ground_is_rough():
    rng = np.random.default_rng(0)
    skeleton = stem_and_branch()
    ground = np.column_stack([rng.uniform(-1, 1, (8000, 2)), 0.004 * rng.standard_normal(8000)])
    stem = np.column_stack([rng.normal(0, 0.01, (500, 2)), rng.uniform(0.03, 1, 500)])
    points = np.vstack([ground, stem])
    labels = np.repeat([int(Label.GROUND), int(Label.TRUNK)], [8000, 500])
    foot = find_foot(skeleton, points, labels)
    assert (foot.source, foot.error) == ("ground", pytest.approx(1.6 * 0.004, rel=0.1))
    foot = find_foot(skeleton, stem, labels[8000:])
    assert (foot.source, foot.error) == ("wood", pytest.approx(0.03, abs=0.01))


def test_a_top_that_thins_out_may_be_higher():
    rng = np.random.default_rng(0)
    top = {}
    for name, step in (("sparse", 0.004), ("dense", 0.0002)):
        z = 2.0 - step * np.arange(600)
        points = np.column_stack([np.zeros((600, 2)), z])
        crown, samples = measure_crown(points, points[:0], n_bootstrap=2000, rng=rng)
        assert crown.top == pytest.approx(2.0 - 2 * step)
        top[name] = samples[:, 0].mean() - crown.top
    # 0.4 of the way from the third to the 21st highest point, 18 steps
    assert top["sparse"] == pytest.approx(0.4 * 18 * 0.004, rel=0.15)
    assert top["dense"] == pytest.approx(0.4 * 18 * 0.0002, rel=0.15)


def test_the_trunk_is_as_unsure_as_its_points_are_rough():
    rng = np.random.default_rng(0)
    angle, z = rng.uniform(0, 2 * np.pi, 6000), rng.uniform(0, 1, 6000)
    radius = 0.05 + 0.002 * rng.standard_normal(6000)
    wood = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
    line = np.column_stack([np.zeros((11, 2)), np.linspace(0, 1, 11)])
    stem = Stem(line, np.full(11, 0.05), line[:, 2], False)
    found = measure_diameter(
        stem, wood, 0.5, half_height=0.1, min_points=60, min_arc_deg=120, n_bootstrap=400, rng=rng
    )
    assert found.samples.std() == pytest.approx(0.7 * 0.002, rel=0.15)


def test_a_crown_that_thins_out_may_be_wider():
    rng = np.random.default_rng(0)
    step, n = 0.002, 300
    along = np.linspace(-1, 1, 1001)
    x = np.column_stack([along, np.zeros(1001), np.zeros(1001)])  # 2 mm between its points
    y = np.column_stack([np.zeros(n), step * (np.arange(n) - n / 2), np.full(n, 0.1)])
    crown, samples = measure_crown(x, np.vstack([x, y]), n_bootstrap=2000, rng=rng)
    assert crown.width == pytest.approx((2.0 + step * (n - 1)) / 2, abs=1e-3)
    lag = 0.4 * 18 * step  # of each of the four ends, see above
    assert samples[:, 1].mean() - crown.width == pytest.approx(0.35 * 4 * lag, rel=0.15)
    assert np.quantile(samples[:, 1], 0.05) < crown.width  # the outermost points are noisy
