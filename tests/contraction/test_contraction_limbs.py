"""Thick wood onto the axes of its rings: known tubes, and what is no limb."""

import numpy as np
import pytest

from cherrypicker.contraction.limbs import recentre_limbs

SPACING = 0.01


def tube(radius, height=0.6, arc=2 * np.pi, lean=0.0, noise=0.002, seed=0):
    """Points on a leaning tube over the origin, and their distances' reference: its direction."""
    generator = np.random.default_rng(seed)
    n = int(arc * radius * height / SPACING**2 * 2)
    angle, z = generator.uniform(0, arc, n), generator.uniform(0, height, n)
    away = radius + generator.normal(0, noise, n)
    points = np.stack([away * np.cos(angle) + lean * z, away * np.sin(angle), z], axis=1)
    return points, np.array([lean, 0.0, 1.0]) / np.hypot(lean, 1.0)


def off_axis(points, axis):
    return np.linalg.norm(points - np.outer(points @ axis, axis), axis=1)


def recentred(points, contracted=None, taken=None):
    contracted = points if contracted is None else contracted
    taken = np.zeros(len(points), dtype=bool) if taken is None else taken
    base = np.array([0.0, 0.0, points[:, 2].min()])
    return recentre_limbs(points, contracted, base, spacing=SPACING, taken=taken)


@pytest.mark.parametrize(("radius", "lean"), [(0.03, 0.0), (0.05, 0.5), (0.08, 0.2)])
def test_a_limb_is_drawn_onto_its_axis(radius, lean):
    points, axis = tube(radius, lean=lean)
    moved, is_moved = recentred(points)
    assert is_moved.mean() > 0.95
    assert np.sqrt(np.mean(off_axis(moved[is_moved], axis) ** 2)) < 0.004
    shift = (moved - points)[is_moved] @ axis  # across the limb only
    assert np.abs(shift).mean() < 0.1 * radius


def test_a_limb_with_a_hole_and_half_a_limb():
    points, axis = tube(0.05)
    seen = np.linalg.norm(points - (0.05, 0.0, 0.3), axis=1) > 0.06
    moved, is_moved = recentred(points[seen])
    assert is_moved.mean() > 0.9
    assert np.quantile(off_axis(moved[is_moved], axis), 0.9) < 0.008
    half, axis = tube(0.05, arc=1.2 * np.pi)
    moved, is_moved = recentred(half)
    assert is_moved.mean() > 0.8
    assert np.median(off_axis(moved[is_moved], axis)) < 0.008


def test_twigs_sheets_and_tufts_stay():
    generator = np.random.default_rng(1)
    twig, _ = tube(0.004)
    sheet = np.stack(
        [
            generator.uniform(0, 0.4, 4000),
            generator.normal(0, 0.002, 4000),
            generator.uniform(0, 0.4, 4000),
        ],
        axis=1,
    )
    tuft = np.vstack(  # twigs from one place, every way up
        [
            np.outer(np.linspace(0, 0.4, 120), way) + generator.normal(0, 0.003, (120, 3))
            for way in generator.normal(0, 0.35, (14, 3)) + (0, 0, 1)
        ]
    )
    for points in (twig, sheet, tuft):
        assert recentred(points)[1].mean() < 0.05


def test_two_limbs_side_by_side_stay_two():
    one, _ = tube(0.04, seed=2)
    other, _ = tube(0.04, seed=3)
    points = np.vstack([one - (0.1, 0, 0), other + (0.1, 0, 0)])
    moved, is_moved = recentred(points)
    assert is_moved.mean() > 0.9
    assert np.all(np.abs(np.abs(moved[is_moved, 0]) - 0.1) < 0.02)


def test_points_on_an_axis_already_stay():
    points, _ = tube(0.05)
    taken = points[:, 2] < 0.3
    moved, is_moved = recentred(points, taken=taken)
    assert not is_moved[taken].any()
    np.testing.assert_array_equal(moved[taken], points[taken])
    assert is_moved[~taken].mean() > 0.9


def test_few_points_are_no_limb():
    points = np.array([[0.0, 0, 0], [0, 0, 0.5], [0.5, 0, 1.0]])
    moved, is_moved = recentred(points)
    assert not is_moved.any()
    np.testing.assert_array_equal(moved, points)


def test_a_short_ring_of_twigs_is_no_limb():
    angle = np.arange(16) * 2 * np.pi / 16
    twigs = [tube(0.004, height=0.07, seed=i)[0] for i in range(16)]
    around = np.stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), np.full(16, 0.3)], axis=1)
    below, _ = tube(0.004, height=0.3)
    points = np.vstack([below, *(twig + at for twig, at in zip(twigs, around))])
    assert not recentred(points)[1].any()
    long, _ = tube(0.05)
    assert recentred(np.vstack([below, long + (0, 0, 0.3)]))[1].any()


def test_the_start_of_a_side_limb_stays_its_own():
    stem, _ = tube(0.06, height=0.8)
    side, _ = tube(0.02, height=0.5, seed=1)
    side = side[:, [2, 1, 0]] * (1, 1, -1) + (0.06, 0, 0.4)
    points = np.vstack([stem, side])
    is_side = np.arange(len(points)) >= len(stem)
    moved, _ = recentred(points)
    beside = is_side & (points[:, 0] > 0.08)
    assert off_axis(moved[beside], np.array([0.0, 0, 1])).min() > 0.06


def test_rings_around_an_axis_claim_nothing():
    stem, _ = tube(0.06, height=0.8)
    taken = np.random.default_rng(0).random(len(stem)) < 0.6  # the rest is the start of side limbs
    assert not recentred(stem, taken=taken)[1].any()
