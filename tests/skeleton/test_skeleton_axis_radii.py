"""Radii of an axis from the surface points around it."""

import numpy as np
import pytest
from skeleton_shapes import tube

from cherrypicker.skeleton.axis_radii import measure_radii
from cherrypicker.skeleton.model import Skeleton


def upright_axis(radius, x=0.0):
    points = np.column_stack([np.full(67, x), np.zeros(67), np.linspace(0, 1, 67)])
    return Skeleton(points, np.arange(-1, 66), np.full(67, radius), np.ones(67))


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_radii_of_a_tapered_stem(noise):
    rng = np.random.default_rng(8)
    surface = tube((0, 0, 0), (0, 0, 1), 0.03, end_radius=0.015, rng=rng, noise=noise)
    z = np.linspace(0, 1, 67)
    skeleton = upright_axis(0.0, x=0.003)  # beside the axis
    told = measure_radii(skeleton, surface, spacing=0.015, max_radius=0.08)
    inner = slice(3, -3)
    np.testing.assert_allclose(told.radius[inner], (0.03 - 0.015 * z)[inner], atol=0.0015)
    assert (told.fields["arc_deg"][inner] > 300).all()
    assert (told.fields["n_points"][inner] > 20).all()


def test_points_without_any_noise_around_a_true_radius_have_next_to_no_error():
    rng = np.random.default_rng(8)
    surface = tube((0, 0, 0), (0, 0, 1), 0.03, rng=rng, noise=0.0)
    told = measure_radii(upright_axis(0.03), surface, spacing=0.015, max_radius=0.08)
    assert (told.fields["radius_error"][3:-3] < 1e-4).all()
    np.testing.assert_allclose(told.radius, 0.03, atol=1e-6)


def test_a_stretch_without_points_takes_the_radius_below_it():
    rng = np.random.default_rng(8)
    surface = tube((0, 0, 0), (0, 0, 1), 0.03, end_radius=0.015, rng=rng)
    surface = surface[(surface[:, 2] < 0.4) | (surface[:, 2] > 0.6)]
    told = measure_radii(upright_axis(0.0), surface, spacing=0.015, max_radius=0.08)
    np.testing.assert_allclose(told.radius[30:37], 0.024, atol=0.001)
    assert (told.fields["n_points"][30:37] == 0).all()
    above = measure_radii(
        upright_axis(0.0), surface[surface[:, 2] > 0.6], spacing=0.015, max_radius=0.08
    )
    np.testing.assert_allclose(above.radius[:36], 0.021, atol=0.001)
    assert (measure_radii(upright_axis(0.0), surface + 9, spacing=1, max_radius=1).radius > 0).all()


@pytest.mark.parametrize(("half", "arc"), [(np.pi, 345.0), (np.pi / 3, 120.0)])
def test_points_say_how_far_the_radius_of_a_limb_is_off(half, arc):
    """A tube's radius is kept; its standard error is larger where less of it is seen."""
    rng = np.random.default_rng(9)
    angle, z = rng.uniform(-half, half, 20_000), rng.uniform(0, 1, 20_000)
    away = 0.02 + rng.normal(0, 0.002, 20_000)
    surface = np.column_stack([away * np.cos(angle), away * np.sin(angle), z])
    told = measure_radii(upright_axis(0.02), surface, spacing=0.015, max_radius=0.08)
    assert (told.radius == 0.02).all()
    assert np.median(told.fields["residual"]) == pytest.approx(0.002, rel=0.1)
    assert np.median(told.fields["arc_deg"]) == pytest.approx(arc, abs=15.0)
    error = np.median(told.fields["radius_error"])
    assert error < 0.0004 if half == np.pi else error > 0.001
