"""Sections of wood whose area is known: radius, standard error, and what thin wood tells."""

import numpy as np
import pytest
from scipy.special import i0e, i1e

from cherrypicker.geometry.rice import bessel_ratio, rice
from cherrypicker.geometry.sections import circles_through, fit_section

RADIUS = 0.05
N_DRAWS, N_POINTS = 200, 1500


def round_(angle):
    return np.ones_like(angle)


def oval(angle):
    """Twice as broad as deep, of a circle's area."""
    return 1 / np.sqrt(np.cos(angle) ** 2 / 2 + 2 * np.sin(angle) ** 2)


def fluted(angle):
    return (1 + 0.08 * np.cos(5 * angle)) / np.sqrt(1 + 0.08**2 / 2)


def slab(rng, noise, *, radius=RADIUS, shape=round_, arc=2 * np.pi, taper=0.0, outliers=0.0):
    """Points of a slab 20 cm high, of which some lie anywhere around."""
    angle, w = rng.uniform(0, arc, N_POINTS), rng.uniform(-0.1, 0.1, N_POINTS)
    away = (radius + taper * w) * shape(angle)
    points = np.stack([away * np.cos(angle), away * np.sin(angle), w], axis=1)
    points += rng.normal(0, noise, points.shape)
    foreign = rng.random(N_POINTS) < outliers
    points[foreign, :2] = rng.uniform(-2.5 * radius, 2.5 * radius, (foreign.sum(), 2))
    return points


@pytest.mark.parametrize(
    ("scene", "waves", "noise"),
    [
        ({}, False, 0.002),
        ({}, True, 0.005),
        ({"arc": np.pi}, False, 0.005),
        ({"shape": oval}, True, 0.005),
        ({"shape": fluted}, True, 0.002),
        ({"taper": -0.05}, True, 0.002),
        ({"outliers": 0.1}, True, 0.005),
    ],
    ids=["round", "round_with_waves", "half_seen", "oval", "fluted", "tapered", "outliers"],
)
def test_the_area_and_how_sure_it_is(scene, waves, noise):
    rng = np.random.default_rng(0)
    first = RADIUS * np.array([0.1, -0.1, 1.1])
    fits = [fit_section(slab(rng, noise, **scene), first, waves=waves) for _ in range(N_DRAWS)]
    off = np.array([fit.radius - RADIUS for fit in fits])
    error = np.array([fit.error for fit in fits])
    assert abs(off.mean()) < 0.002 * RADIUS
    assert off.std() < 0.01 * RADIUS
    assert 0.85 <= np.mean(np.abs(off) < 1.645 * error) <= 0.95


def test_a_round_section_seen_from_one_side_may_be_any_outline_there():
    rng = np.random.default_rng(1)
    points = [slab(rng, 0.002, arc=np.pi) for _ in range(20)]
    free, round_too = (
        [fit_section(some, np.array([0, 0, RADIUS]), waves=waves) for some in points]
        for waves in (True, False)
    )
    assert np.median([fit.error for fit in free]) > 2 * np.median([fit.error for fit in round_too])
    assert np.mean([fit.radius for fit in free]) == pytest.approx(RADIUS, rel=0.02)
    assert free[0].arc_deg == pytest.approx(190, abs=11)


@pytest.mark.parametrize(("radius", "noise"), [(0.02, 0.005), (0.01, 0.003)])
def test_noise_does_not_make_wood_thick(radius, noise):
    rng = np.random.default_rng(2)
    start = np.array([0.0, 0.0, 1.2 * radius])
    radii = [fit_section(slab(rng, noise, radius=radius), start).radius for _ in range(40)]
    assert np.mean(radii) == pytest.approx(radius, abs=0.0001)


def test_points_that_leave_a_section_open_have_none():
    assert fit_section(np.full((20, 3), np.nan), np.array([0, 0, RADIUS])) is None


def test_derivatives_of_the_likelihood():
    away, radius, noise, step = 0.007, 0.004, 0.003, 1e-7
    kappa = away * radius / noise**2
    assert bessel_ratio(kappa) == pytest.approx(i1e(kappa) / i0e(kappa), rel=1e-8)
    assert bessel_ratio(30.0) == pytest.approx(i1e(30.0) / i0e(30.0), rel=1e-8)

    def cost(q, r):
        kappa = q * r / noise**2
        return (q**2 + r**2) / 2 - noise**2 * (np.log(i0e(kappa)) + kappa)

    by_away, by_radius, *_ = rice(away, radius, noise, 1.0)
    slope = (cost(away + step, radius) - cost(away - step, radius)) / (2 * step)
    assert by_away == pytest.approx(slope, rel=1e-5)
    slope = (cost(away, radius + step) - cost(away, radius - step)) / (2 * step)
    assert by_radius == pytest.approx(slope, rel=1e-5)


def test_circles_through_three_points():
    angles = np.array([[0.1, 2.0, 4.0], [1.0, 1.5, 5.0]])
    triples = 0.3 * np.stack([np.cos(angles), np.sin(angles)], axis=2) + [1.0, 2.0]
    np.testing.assert_allclose(circles_through(triples), [[1.0, 2.0, 0.3]] * 2)
    line = np.array([[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]])
    assert not np.isfinite(circles_through(line)).all()
