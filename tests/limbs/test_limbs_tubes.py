"""Tubes fitted to points whose axis and radius are known."""

import numpy as np
import pytest

from cherrypicker.limbs.tubes import (
    LEAST_COVER,
    STEP,
    Tube,
    covered,
    even,
    fit_tube,
    place_on_axis,
    seen_from,
    smooth,
    tube_through,
)

LENGTH = 0.6


def bent_limb(radius, *, arc=2 * np.pi, noise=0.003, spacing=0.008, seed=0):
    """Points on a limb along z that bends towards x, and its axis at heights z."""
    rng = np.random.default_rng(seed)
    n = int(max(80, LENGTH * radius * arc / spacing**2))
    z, angle = rng.uniform(0, LENGTH, n), rng.uniform(0, arc, n)
    points = np.stack([radius * np.cos(angle) + 0.1 * z**2, radius * np.sin(angle), z], axis=1)
    return points + rng.normal(0, noise, points.shape)


def fitted(points, noise=0.003):
    """The tube that is found from a straight line through the middle of the points."""
    z = np.linspace(0, LENGTH, 30)
    middle = points.mean(axis=0)
    nodes = np.stack([np.full(30, middle[0]), np.full(30, middle[1]), z], axis=1)
    radius = np.median(np.linalg.norm((points - middle)[:, :2], axis=1))
    start = Tube(nodes, np.full(30, radius))
    return fit_tube(points, start, noise=noise, spacing=0.008, cutoff=max(0.03, radius))[0]


def off_axis(tube):
    z = tube.nodes[:, 2]
    return np.linalg.norm(tube.nodes[:, :2] - np.stack([0.1 * z**2, 0 * z], axis=1), axis=1)


def test_a_tube_through_patches_of_a_thick_limb_runs_in_its_middle():
    points, height = bent_limb(0.08, spacing=0.01), 0.01
    turn = np.arctan2(points[:, 1], points[:, 0] - 0.1 * points[:, 2] ** 2)
    ring = (points[:, 2] / height).astype(int)
    beside = np.cos(turn - 1.7 * ring) > 0.5  # a third of each, farther around the limb each time
    rings = [points[(ring == k) & beside] for k in range(int(LENGTH / height))]
    tube = tube_through(rings, height)
    inner = slice(8, -8)
    assert off_axis(tube)[inner].max() < 0.03  # the middles of the patches lie 0.066 off
    assert np.median(tube.radius) == pytest.approx(0.08, abs=0.008)
    one = tube_through([points[:10], points[10:20]], height)
    assert np.allclose(one.nodes, [points[:10].mean(axis=0), points[10:20].mean(axis=0)])


@pytest.mark.parametrize("radius", [0.1, 0.05, 0.02, 0.012])
def test_a_limb_seen_all_around(radius):
    tube = fitted(bent_limb(radius))
    assert np.median(tube.radius) == pytest.approx(radius, abs=0.0008)
    assert np.median(off_axis(tube)) < 0.0015


@pytest.mark.parametrize("radius", [0.1, 0.05, 0.02])
def test_a_limb_seen_from_one_side_is_not_drawn_to_what_was_seen(radius):
    tube = fitted(bent_limb(radius, arc=2.5))
    assert np.median(tube.radius) == pytest.approx(radius, rel=0.05)
    assert np.median(off_axis(tube)) < 0.003


@pytest.mark.parametrize("radius", [0.002, 0.004])
def test_a_twig_thinner_than_the_noise_keeps_its_axis(radius):
    tube = fitted(bent_limb(radius))
    assert np.median(off_axis(tube)) < 0.003
    assert np.median(tube.radius) < 0.0055


def test_a_line_of_points_is_not_the_flank_of_a_thick_limb():
    points = bent_limb(0.002, noise=0.002)
    z = np.linspace(0, LENGTH, 30)
    nodes = np.stack([0.1 * z**2 + 0.008, 0 * z, z], axis=1)
    start = Tube(nodes, np.full(30, 0.008))
    tube, _ = fit_tube(points, start, noise=0.003, spacing=0.008, cutoff=0.016)
    assert tube.radius.max() < 0.008
    assert np.median(off_axis(tube)) < 0.002


def test_a_tube_around_twigs_is_no_thicker_than_what_bears_them():
    twigs = [bent_limb(0.004, noise=0.001) + (x, y, 0) for x, y in ((0.1, 0), (0, 0.1), (-0.1, 0))]
    z = np.linspace(0, LENGTH, 8)
    around = Tube(np.stack([0.1 * z**2, 0 * z, z], axis=1), np.full(8, 0.1))
    free, bounded = (
        fit_tube(np.vstack(twigs), around, noise=0.002, spacing=0.008, cutoff=0.02, widest=widest)[
            0
        ]
        for widest in (np.inf, 0.01)
    )
    assert np.median(free.radius) > 0.09
    assert np.median(bounded.radius) < 0.011


def test_a_whole_limb_covers_its_surface_and_two_twigs_do_not_cover_that_of_a_tube_through_them():
    spacing = 0.008
    limb, twig = bent_limb(0.02, spacing=spacing), bent_limb(0.003, spacing=spacing)
    z = np.linspace(0, LENGTH, 30)
    tube = Tube(np.stack([0.1 * z**2, 0 * z, z], axis=1), np.full(30, 0.02))
    twigs = np.vstack([twig + (0, y, 0) for y in (-0.02, 0.02)])
    assert covered(limb, tube, spacing, 0.01) > LEAST_COVER
    assert covered(limb[limb[:, 1] > 0.01], tube, spacing, 0.01) < LEAST_COVER
    assert covered(twigs, tube, spacing, 0.01) < LEAST_COVER


def test_a_twig_beside_a_limb_does_not_bend_it():
    limb = bent_limb(0.02)
    rng = np.random.default_rng(1)
    z = np.linspace(0.3, 0.5, 120)
    twig = np.stack([0.1 * z**2 + 0.02 + 0.5 * (z - 0.3), 0 * z, z], axis=1)
    tube = fitted(np.vstack([limb, twig + rng.normal(0, 0.002, twig.shape)]))
    assert off_axis(tube).max() < 0.004
    assert np.median(tube.radius) == pytest.approx(0.02, abs=0.001)


def test_places_on_an_axis_and_beyond_its_ends():
    nodes = np.array([[0, 0, 0], [0, 0, 1], [0, 1, 1]], dtype=float)
    points = np.array([[0.1, 0, 0.5], [0, 0.4, 1.2], [0, 0, -0.3], [0, 1.5, 1]])
    segment, share = place_on_axis(points, nodes)
    assert segment.tolist() == [0, 1, 0, 1]
    np.testing.assert_allclose(share, [0.5, 0.4, -0.3, 1.5])
    seen = seen_from(Tube(nodes, np.array([0.3, 0.2, 0.1])), points)
    np.testing.assert_allclose(seen.away, [0.1, 0.2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(seen.radius, [0.25, 0.16, 0.3, 0.1])
    np.testing.assert_allclose(seen.way, [0.5, 1.4, -0.3, 2.5])
    np.testing.assert_allclose(seen.beyond, [0, 0, 0.3, 0.5], atol=1e-12)


def test_nodes_lie_as_far_apart_as_the_limb_is_thick():
    z = np.linspace(0, 1, 101)
    tube = Tube(np.stack([0 * z, 0 * z, z], axis=1), np.where(z < 0.5, 0.1, 0.01))
    step = np.diff(even(tube, 0.02 / STEP).nodes[:, 2])
    assert step[0] == pytest.approx(0.1, rel=0.15) and step[-1] == pytest.approx(0.02, rel=0.15)
    place = Tube(np.zeros((3, 3)), np.ones(3))
    assert even(place, 0.02) is place
    curve = smooth(tube, 0.03)
    assert np.linalg.norm(np.diff(curve.nodes, axis=0), axis=1).max() <= 0.03 + 1e-9
    np.testing.assert_allclose(curve.nodes[[0, -1]], tube.nodes[[0, -1]])


def test_a_start_that_zigzags_is_fitted_all_the_same():
    """Ends of segments see points aslant, where the equations once had no solution."""
    rng = np.random.default_rng(5)
    angle, z = rng.uniform(0, 2 * np.pi, 3000), rng.uniform(0, 0.5, 3000)
    points = np.column_stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), z])
    height = np.repeat(np.linspace(0, 0.5, 30), 2)  # two nodes at each height fall together,
    aside = np.tile([0, 0, 0.04, 0.04, -0.04, -0.04], 10)  # and the axis swings from side to side
    start = Tube(np.column_stack([aside, np.roll(aside, 2), height]), np.full(60, 0.03))
    found, residual = fit_tube(points, start, noise=0.001, spacing=0.005, cutoff=0.05)
    assert np.isfinite(found.nodes).all() and np.isfinite(residual).all()
