"""Intervals of the traits, on trees and numbers with known answers."""

import csv
import io
import re

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.geometry.error_terms import FACTORS, FACTORS_FILE, KNOWN, spread
from cherrypicker.geometry.hulls import hull_of, reach_around, width_of
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.branches import branch_rows, branches_csv
from cherrypicker.traits.crown import grown, measure_crown
from cherrypicker.traits.foot import find_foot
from cherrypicker.traits.intervals import Z90, interval
from cherrypicker.traits.shoot_ends import ShootEnds, draw_tips, find_shoot_ends
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
        fields |= {"residual": np.asarray(residual, dtype=float), "radius_error": np.full(n, 2e-4)}
    return Skeleton(np.vstack([stem, branch]), parent, radius, np.full(n, 1), fields)


def branch_row(skeleton, **options):
    return branch_rows(skeleton, axes(skeleton), 0.0, **options)[1]


def test_errors_are_independent_and_drawn_ends_add_to_one_side():
    terms = {"fit": 0.0006, "diameter_shared": 0.001}
    sd = np.hypot(0.0006, FACTORS["diameter_shared"] * 0.001)
    assert spread(terms) == pytest.approx(sd)
    assert interval(0.020, terms) == pytest.approx((0.020 - Z90 * sd, 0.020 + Z90 * sd))
    low, high = interval(2.0, {"scale": 0.01}, (0.0, 0.03))
    assert (low, high) == pytest.approx((2.0 - Z90 * 0.01, 2.0 + np.hypot(Z90 * 0.01, 0.03)))
    assert interval(0.001, {"fit": 0.002})[0] == 0.0


def test_columns_of_a_branch():
    row = branch_row(stem_and_branch(residual=np.full(76, 0.001)))
    assert row["base_diameter_m"] == pytest.approx(0.020)
    assert row["insertion_angle_deg"] == pytest.approx(90.0)
    expected = interval(0.020, {"fit": 0.0004, "diameter_shared": 0.001})
    assert (row["base_diameter_low_m"], row["base_diameter_high_m"]) == pytest.approx(expected)
    assert row["insertion_angle_low_deg"] + row["insertion_angle_high_deg"] == pytest.approx(180.0)
    loose = branch_row(stem_and_branch(residual=np.full(76, 0.001)), scale_error=0.2)
    assert loose["base_diameter_high_m"] > 0.020 + 1.6 * 0.2 * 0.020
    assert loose["insertion_angle_high_deg"] == row["insertion_angle_high_deg"]


def test_no_scatter_no_interval():
    skeleton = stem_and_branch()
    rows = branch_rows(skeleton, axes(skeleton), 0.0)
    assert rows[1]["base_diameter_low_m"] is None
    table = list(csv.DictReader(io.StringIO(branches_csv(rows))))
    assert table[1]["insertion_angle_high_deg"] == ""


def trunk_of(skeleton):
    return axes(skeleton)[0].nodes


def test_twigs_that_hang_about_the_foot_do_not_lift_it():
    rng = np.random.default_rng(5)
    turn, z = rng.uniform(0, 2 * np.pi, 6000), rng.uniform(0, 1, 6000)
    trunk = np.column_stack([0.09 * np.cos(turn), 0.09 * np.sin(turn), z])
    low = np.column_stack([rng.uniform(-0.3, 0.3, (4000, 2)), rng.uniform(0.25, 0.5, 4000)])
    nodes = np.column_stack([np.zeros((11, 2)), np.linspace(0, 1, 11)])
    hung = low[:400] + [0.0, 0.0, 0.05]
    skeleton = Skeleton(
        np.vstack([nodes, hung]),
        np.concatenate([np.arange(-1, 10), np.full(400, 5)]),
        np.repeat([0.09, 0.003], [11, 400]),
        np.ones(411, dtype=int),
    )
    points = np.vstack([trunk, low])
    foot = find_foot(skeleton, np.arange(11), points, np.full(len(points), Label.BRANCH))
    assert foot.source == "wood"
    assert foot.point[2] == pytest.approx(0.0, abs=0.02)
    assert foot.error < 0.02


def test_the_foot_without_ground_is_as_unsure_as_its_lowest_points():
    rng = np.random.default_rng(0)
    skeleton = stem_and_branch()
    ground = np.column_stack([rng.uniform(-1, 1, (8000, 2)), 0.004 * rng.standard_normal(8000)])
    stem = np.column_stack([rng.normal(0, 0.01, (500, 2)), rng.uniform(0.03, 1, 500)])
    points = np.vstack([ground, stem])
    labels = np.repeat([int(Label.GROUND), int(Label.TRUNK)], [8000, 500])
    foot = find_foot(skeleton, trunk_of(skeleton), points, labels)
    assert (foot.source, foot.error) == ("ground", 0.0)
    assert abs(foot.point[2]) < 0.001
    foot = find_foot(skeleton, trunk_of(skeleton), stem, labels[8000:])
    assert (foot.source, foot.error) == ("wood", pytest.approx(0.03, abs=0.01))


def shoot(start, direction, length, step):
    """A straight shoot as nodes every 2 cm, and its wood points, one every `step`."""
    along = np.arange(0.0, length + 1e-9, 0.02)
    points = np.asarray(start) + step * np.arange(int(length / step) + 1)[:, None] * direction
    return np.asarray(start) + along[:, None] * direction, points


def as_skeleton(*lines):
    """A skeleton whose first line is the stem; the others hang on its last node."""
    n = [len(line) for line in lines]
    parent = [np.arange(-1, n[0] - 1)]
    for number in range(1, len(lines)):
        first = sum(n[:number])
        parent.append(np.concatenate([[n[0] - 1], np.arange(first, first + n[number] - 1)]))
    size = sum(n)
    parent = np.concatenate(parent)
    return Skeleton(np.vstack(lines), parent, np.full(size, 0.003), np.ones(size, dtype=int))


def ends_of(skeleton, points):
    everything = np.ones(len(skeleton), bool)
    return find_shoot_ends(skeleton, axes(skeleton), everything, cKDTree(points), 0.03)


def crown_of(skeleton, points, crown_points, scatter, n_samples):
    """Extent and samples of a crown, and the hull of its points."""
    rng, hull = np.random.default_rng(0), hull_of(crown_points)
    tips = draw_tips(ends_of(skeleton, points), n_samples, rng)
    in_crown = np.ones(tips.shape[1], bool)
    return *measure_crown(points, hull, tips, in_crown, scatter, rng), hull


def test_a_top_that_thins_out_is_higher_and_less_sure():
    tops = {}
    for name, step in (("sparse", 0.01), ("dense", 0.0005)):
        line, points = shoot([0.0, 0.0, 1.0], [0.0, 0.0, 1.0], 1.0, step)
        extent, samples, _ = crown_of(as_skeleton(line), points, points[:0], 0.0, 4000)
        low, high = np.quantile(samples[:, 0], [0.05, 0.95])
        tops[name] = extent[0] - 2.0, low - 2.0, high - 2.0
        assert extent[0] == np.median(samples[:, 0])
        assert (samples[:, 1:] == 0).all()
    # Points 1 cm apart: twice that is the scale of a loss; one of five is 3 scales long
    assert tops["sparse"][2] == pytest.approx(0.08, abs=0.02)
    assert 0 < tops["sparse"][0] < 0.01
    assert tops["dense"][2] < 0.01
    assert abs(tops["dense"][0]) < 0.002


def test_the_trunk_is_as_unsure_as_its_points_are_rough():
    rng = np.random.default_rng(0)
    angle, z = rng.uniform(0, 2 * np.pi, 6000), rng.uniform(0, 1, 6000)
    radius = 0.05 + 0.002 * rng.standard_normal(6000)
    wood = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
    line = np.column_stack([np.zeros((11, 2)), np.linspace(0, 1, 11)])
    stem = Stem(line, np.full(11, 0.05), line[:, 2])
    found = measure_diameter(stem, wood, 0.5, rng=rng)
    assert found.terms["trunk_shared"] == pytest.approx(0.002, rel=0.1)
    assert found.terms["trunk_hidden"] == found.diameter == pytest.approx(0.1, rel=0.01)
    assert 0 < found.terms["fit"] < 0.001


def test_losses_are_short_for_most_and_long_for_some():
    ends = ShootEnds(np.zeros(1, int), np.zeros((1, 3)), np.eye(3)[:1], np.array([0.02]), 0.003)
    losses = draw_tips(ends, 100_000, np.random.default_rng(0))[:, 0, 0] + 0.003
    assert losses.min() >= 0
    assert losses.mean() == pytest.approx(0.02 * (0.8 * 0.3 + 0.2 * 3.0), rel=0.02)
    assert np.median(losses) == pytest.approx(0.006, rel=0.1)


def test_a_tube_along_a_shoot_counts_its_points():
    line, points = shoot([0.2, 0.1, 0.5], np.array([0.6, 0.0, 0.8]), 0.4, 0.004)
    aside = points + [0.0, 0.02, 0.0]  # beyond the tube
    ends = ends_of(as_skeleton(line), np.vstack([points, aside]))
    np.testing.assert_allclose(ends.points, [line[-1]])
    np.testing.assert_allclose(ends.directions, [[0.6, 0.0, 0.8]], atol=1e-9)
    np.testing.assert_allclose(ends.scale, 2.0 * 0.03 / 8)  # points at 0, 4, ... 28 mm


def test_a_lost_end_widens_the_crown_and_noise_narrows_it():
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    hull = hull_of(corners)
    assert (hull.volume, hull.area) == pytest.approx((2.0, 10.0))
    tips = [np.array([[0.9 + lost, 0.0, 0.5]]) for lost in (0.0, 0.1, 0.4, 0.0)]
    over = [0.0, 0.0, 0.0, 0.01]
    width, volume = np.transpose([grown(hull, *each) for each in zip(tips, over, strict=True)])
    way = np.radians(27.0)  # of the diagonal, to whole degrees
    plain = (3.0 * np.cos(way) + 3.0 * np.sin(way)) / 2
    np.testing.assert_allclose(width[:2], plain, rtol=1e-9)
    assert width[3] == pytest.approx(plain - 0.02)
    longer = np.vstack([corners[:, :2], [1.3, 0.0]])
    assert width[2] == pytest.approx(width_of(reach_around(longer))) != width[0]
    np.testing.assert_allclose(volume, [2.0, 2.0, 2.0 + 0.3 / 3, 2.0 - 10.0 * 0.01], rtol=1e-9)


def test_two_ends_side_by_side_widen_the_crown_once():
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    tips = np.array([[1.3, 0.5, 0.5], [1.3, 0.5, 0.51]])
    one, both = (grown(hull_of(corners), tips[:n])[1] for n in (1, 2))
    assert one == pytest.approx(1.0 + 0.3 / 3)
    assert one < both < one + 0.01


def test_an_uncertain_crown_holds_its_estimate():
    stem, stem_points = shoot([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], 1.0, 0.002)
    ways = np.array([[1.0, 0, 0.5], [-1, 0, 0.5], [0, 1, 0.5], [0, -1, 0.5]]) / np.hypot(1, 0.5)
    shoots = [shoot([0.0, 0.0, 1.0], way, 0.8, 0.01) for way in ways]
    skeleton = as_skeleton(stem, *(line for line, _ in shoots))
    crown_points = np.vstack([points for _, points in shoots])
    points = np.vstack([stem_points, crown_points])
    extent, samples, hull = crown_of(skeleton, points, crown_points, 0.002, 400)
    low, high = np.quantile(samples, [0.05, 0.95], axis=0)
    plain = 1.6 / np.hypot(1, 0.5)
    assert low[1] - 0.01 < plain < extent[1] < high[1] < plain + 0.2
    assert low[2] <= extent[2] < high[2] and hull.volume < extent[2]
    none, samples, _ = crown_of(skeleton, points, crown_points, 0.002, 0)
    assert none[1:] == pytest.approx([plain, hull.volume]) and not len(samples)


def test_every_factor_of_the_intervals_is_used():
    rooms = FACTORS_FILE.parents[1]
    files = *(rooms / "traits").glob("*.py"), rooms / "geometry/error_terms.py"
    code = "".join(path.read_text() for path in files)
    used = set(re.findall(r'FACTORS\["(\w+)"\]', code)) | set(re.findall(r'"(\w+)": ', code))
    assert set(FACTORS) <= used
    assert not set(KNOWN) & set(FACTORS)


@pytest.mark.parametrize(
    "up, source, gap", [(0.02, "ground", 0.02), (0.8, "ground", 0.8), (-0.8, "wood", 0.0)]
)
def test_a_tree_stands_on_the_ground_however_far_up_its_lowest_points_lie(up, source, gap):
    rng = np.random.default_rng(3)
    skeleton = stem_and_branch()
    turn, z = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(0, 1, 4000)
    stem = np.column_stack([0.02 * np.cos(turn), 0.02 * np.sin(turn), z])
    soil = np.column_stack([rng.uniform(-1, 1, (8000, 2)), np.full(8000, -up)])
    labels = np.repeat([Label.TRUNK, Label.GROUND], [4000, 8000])
    foot = find_foot(skeleton, trunk_of(skeleton), np.vstack([stem, soil]), labels)
    assert foot.source == source
    assert foot.gap == pytest.approx(gap, abs=0.012)
