"""Limbs, their ratio to the stem, and crown formulas, on trees whose answers are known."""

import numpy as np
import pytest
from test_traits import Tree

from cherrypicker.geometry.error_terms import FACTORS, spread
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.crown import contour_volume
from cherrypicker.traits.limb_table import by_diameter, ratio_terms, squares_terms
from cherrypicker.traits.measure import TraitOptions, measure_traits
from cherrypicker.traits.scaffold import Limb, Scaffold


@pytest.fixture(scope="module")
def limbed():
    """Three limbs of 24, 20 and 16 mm, a stub of 30 mm below them."""
    tree = Tree(noise=0.001)
    tree.add_ground()
    tree.add_branch(0.9, 60, 90, 0.8, radius=0.012)
    tree.add_branch(1.2, 50, 210, 0.7, radius=0.010)
    tree.add_branch(1.5, 70, 330, 0.6, radius=0.008)
    tree.add_branch(0.6, 90, 0, 0.12, radius=0.015)
    return tree


@pytest.fixture(scope="module")
def measured(limbed):
    return measure_traits(limbed.skeleton(), limbed.scan())


def test_limbs_by_size_and_their_ratio_to_the_stem(limbed, measured):
    traits, tables = measured
    rows = tables["limbs"]
    assert [row["rank"] for row in rows] == [1, 2, 3]
    diameters = np.array([row["diameter_m"] for row in rows])
    np.testing.assert_allclose(diameters, [0.024, 0.020, 0.016], rtol=0.05)
    assert all(row["diameter_low_m"] < row["diameter_m"] < row["diameter_high_m"] for row in rows)
    np.testing.assert_allclose([row["azimuth_deg"] for row in rows], [90, 210, 330], atol=2)
    np.testing.assert_allclose([row["crotch_angle_deg"] for row in rows], [60, 50, 70], atol=1)
    true = np.sum(np.square([0.024, 0.020, 0.016])) / limbed.diameter_at(0.30) ** 2
    assert traits["limb_trunk_ratio"] == pytest.approx(true, rel=0.08)
    low, high = traits["limb_trunk_ratio_ci90"]
    assert low < true < high
    left = [np.sum(diameters[k:] ** 2) / traits["trunk_diameter_m"] ** 2 for k in (1, 2, 3)]
    np.testing.assert_allclose([row["ratio_without"] for row in rows], left, atol=1e-6)
    assert sum(row["area_share"] for row in rows) == pytest.approx(1.0)
    assert sum(row["area_cm2"] for row in rows) == pytest.approx(traits["limb_area_cm2"], abs=1e-5)


def test_a_stub_is_no_limb(limbed, measured):
    traits, tables = measured
    assert traits["n_limbs"] == 3
    assert sum(traits["n_limbs_by_diameter"].values()) == 3
    comes_out = 0.9 + 0.049 / np.tan(np.radians(60))
    assert traits["crown_base_height_m"] == pytest.approx(comes_out, abs=0.03)
    bare = Tree(noise=0.001)
    bare.add_branch(0.6, 90, 0, 0.12, radius=0.015)
    traits, tables = measure_traits(bare.skeleton(), bare.scan())
    assert (traits["n_limbs"], tables["limbs"]) == (0, [])
    assert traits["crown_width_m"] > 0.1  # without limbs the crown begins at the lowest side axis
    assert traits["limb_trunk_ratio"] == 0.0
    assert traits["crown_base_height_m"] == pytest.approx(0.6, abs=0.03)


def test_the_stem_is_measured_above_the_graft_where_that_is_told(limbed):
    options = TraitOptions(graft_height_m=0.2, row_distance_m=4.0)
    traits, _ = measure_traits(limbed.skeleton(), limbed.scan(), options=options)
    assert (traits["limb_trunk_height_m"], traits["trunk_height_m"]) == (0.5, 0.3)
    row = traits["height_m"] * traits["crown_width_m"] * 2500
    assert traits["tree_row_volume_m3_ha"] == pytest.approx(row, abs=0.1)
    plain, _ = measure_traits(limbed.skeleton(), limbed.scan("arbitrary"), options=options)
    assert plain["tree_row_volume_m3_ha"] is None


def grown(*runs):
    """A skeleton of a stem and runs of (parent run, node of it, points, radius)."""
    points, parent, radius, first = [], [], [], []
    for up, node, line, thick in runs:
        first.append(len(points))
        parent += [first[up] + node if first[:-1] else -1]
        parent += range(len(points), len(points) + len(line) - 1)
        points += [*line]
        radius += [thick] * len(line)
    return Skeleton(points, parent, radius, np.ones(len(points)))


def line(start, end, n):
    return np.linspace(start, end, n)


STEM = (0, 0, line([0, 0, 0], [0, 0, 2], 101), 0.05)


def limbs_of(skeleton):
    return Scaffold(skeleton, least=0.1).limbs


def test_a_limb_that_runs_along_the_stem_leaves_where_it_comes_out():
    up = line([0.02, 0, 0.42], [0.02, 0, 0.9], 25)
    out = line([0.04, 0, 0.92], [0.6, 0, 1.4], 40)
    skeleton = grown(STEM, (0, 20, np.vstack([up, out]), 0.01))
    scaffold = Scaffold(skeleton, least=0.1)
    (limb,) = scaffold.limbs
    assert skeleton.points[limb.stem_node, 2] == pytest.approx(0.93, abs=0.03)
    assert skeleton.points[~scaffold.clear_stem(), 2].min() > 0.9


def test_what_leaves_a_limb_at_the_stem_is_a_limb_of_its_own():
    first = line([0.02, 0, 1.0], [0.8, 0, 1.3], 41)
    near = line(first[2] + [0, 0.01, 0.01], first[2] + [0, 0.5, 0.3], 26)
    far = line(first[9] + [0, 0.01, 0.01], first[9] + [0, 0.5, 0.3], 26)
    skeleton = grown(STEM, (0, 50, first, 0.015), (1, 2, near, 0.012), (1, 9, far, 0.010))
    limbs = limbs_of(skeleton)
    assert sorted(round(limb.diameter, 4) for limb in limbs) == [0.024, 0.030]


def vase(fork, *hung):
    """A stem of 50 mm radius and limbs from z = 1, which a skeleton joins at a height of `fork`."""
    away = np.array([[1, 0, 1.2], [-0.5, 0.87, 1.2], [-0.5, -0.87, 1.2]])
    ends = away / np.linalg.norm(away, axis=1)[:, None]
    n = round(fork / 0.02)
    stem = (0, 0, line([0, 0, 0], [0, 0, fork], n + 1), 0.05)
    lines = [line([0, 0, 1], [0, 0, 1] + end, 101)[1:] for end in ends]
    return grown(stem, *((0, n, each, 0.03) for each in lines), *hung), lines


def test_limbs_of_a_fork_are_measured_where_they_are_wherever_the_skeleton_forks():
    low, high = (sorted(limbs_of(vase(fork)[0]), key=lambda b: b.axis) for fork in (0.96, 1.0))
    assert len(low) == len(high) == 3
    for one, other in zip(low, high, strict=True):
        np.testing.assert_allclose(one.place, other.place, atol=0.004)
        away = np.hypot(*one.place[:2])
        assert away == pytest.approx(0.05 + 0.025 * np.sin(np.radians(39.8)), abs=0.006)


def test_a_limb_of_the_fork_that_hangs_on_another_is_one_a_lateral_is_none():
    _, lines = vase(1.0)
    side = lines[0][7] + np.outer(np.linspace(0.01, 0.8, 80), [0.0, 0.8, 0.6])
    twin, lateral = ((1, 7, side, radius) for radius in (0.026, 0.015))
    assert len(limbs_of(vase(1.0, twin)[0])) == 4
    assert len(limbs_of(vase(1.0, lateral)[0])) == 3


def test_an_axis_with_the_stems_points_alone_is_no_limb():
    skeleton, _ = vase(1.0)
    skeleton.fields["n_points"] = np.ones(len(skeleton))
    skeleton.fields["n_points"][axes(skeleton)[2].nodes[3:]] = 0
    assert sorted(limb.axis for limb in limbs_of(skeleton)) == [1, 3]


def test_a_leader_above_a_burl_is_no_limb():
    burl = (0, 0, line([0, 0, 0], [0, 0, 1], 51), 0.05)
    leader = (0, 50, line([0, 0, 1.02], [0, 0, 2], 50), 0.03)  # under 0.8 of the trunk
    aside = (0, 50, line([0.02, 0, 1.01], [0.8, 0, 1.3], 41), 0.015)
    found = Scaffold(grown(burl, leader, aside), least=0.1)
    assert len(found.stem) == 2 and len(found.limbs) == 1
    assert found.limbs[0].diameter == pytest.approx(0.03)
    twin = (0, 50, line([0.02, 0, 1.01], [0.8, 0, 1.3], 41), 0.028)
    found = Scaffold(grown(burl, leader, twin), least=0.1)
    assert len(found.stem) == 1 and len(found.limbs) == 2


def test_the_contour_of_a_cylinder():
    rng = np.random.default_rng(0)
    turn, away = rng.uniform(0, 2 * np.pi, 20_000), np.sqrt(rng.random(20_000))
    height = rng.uniform(1, 3, 20_000)
    points = np.column_stack([5 + away * np.cos(turn), away * np.sin(turn), height])
    assert contour_volume(points, np.array([5.0, 0.0])) == pytest.approx(2 * np.pi, rel=0.01)
    assert contour_volume(np.zeros((0, 3)), np.zeros(2)) == 0.0


def test_limbs_are_counted_by_diameter(limbed):
    limbs = limbs_of(limbed.skeleton())
    count = by_diameter(limbs, (0.03, 0.02))  # a limb of 20 mm is of the class that begins there
    assert count == {"0-0.02": 1, "0.02-0.03": 2, "0.03-": 0}


def test_the_ratio_errs_as_drawn_limbs_and_stems_do():
    rng = np.random.default_rng(0)
    each = [(0.03, 0.0004, 0.001), (0.02, 0.0006, 0.002), (0.015, 0.0002, 0.0015)]
    limbs = [Limb(1, 0, np.zeros(3), width, *rest) for width, *rest in each]
    width, error, scatter = np.array(each).T
    stem, terms = 0.06, {"fit": 0.001, "trunk_shared": 0.001}
    own, shared = rng.standard_normal((20_000, 3)), rng.standard_normal((20_000, 1))
    drawn = width + 2 * error * own + FACTORS["diameter_shared"] * scatter * shared
    squares = (drawn**2).sum(axis=1)
    assert spread(squares_terms(limbs)) == pytest.approx(squares.std(), rel=0.03)
    stems = stem + spread(terms) * rng.standard_normal(20_000)
    told = ratio_terms(squares_terms(limbs), (width**2).sum() / stem**2, stem, terms)
    assert spread(told) == pytest.approx((squares / stems**2).std(), rel=0.03)
    assert squares_terms([]) == ratio_terms({}, 0.0, stem, terms) == {}
