"""Radii of an axis from the surface points around it."""

import numpy as np
import pytest
from skeleton_shapes import tube

from cherrypicker.skeleton.axis_radii import fit_axis_radii
from cherrypicker.skeleton.model import Skeleton


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_radii_of_a_tapered_stem(noise):
    rng = np.random.default_rng(8)
    surface = tube((0, 0, 0), (0, 0, 1), 0.03, end_radius=0.015, rng=rng, noise=noise)
    z = np.linspace(0, 1, 67)
    points = np.column_stack([np.full(67, 0.006), np.zeros(67), z])  # beside the axis
    skeleton = Skeleton(points, np.arange(-1, 66), np.zeros(67), np.ones(67))
    fitted = fit_axis_radii(skeleton, surface, spacing=0.015, max_radius=0.08)
    inner = slice(3, -3)
    np.testing.assert_allclose(fitted.radius[inner], (0.03 - 0.015 * z)[inner], atol=0.0012)
    assert (fitted.fields["arc_deg"][inner] > 300).all()
    assert (fitted.fields["n_points"][inner] > 20).all()


def test_stretch_without_points_takes_radii_from_both_sides():
    rng = np.random.default_rng(8)
    surface = tube((0, 0, 0), (0, 0, 1), 0.03, end_radius=0.015, rng=rng)
    surface = surface[(surface[:, 2] < 0.4) | (surface[:, 2] > 0.6)]
    z = np.linspace(0, 1, 67)
    points = np.column_stack([np.zeros(67), np.zeros(67), z])
    skeleton = Skeleton(points, np.arange(-1, 66), np.zeros(67), np.ones(67))
    fitted = fit_axis_radii(skeleton, surface, spacing=0.015, max_radius=0.08)
    np.testing.assert_allclose(fitted.radius[30:37], (0.03 - 0.015 * z)[30:37], atol=0.002)


@pytest.mark.parametrize("radius", [0.004, 0.008])
def test_thin_wood_takes_the_noise_that_a_thick_stem_shows(radius):
    rng = np.random.default_rng(9)
    stem = tube((0, 0, 0), (0, 0, 1), 0.04, rng=rng)
    surface = np.vstack([stem, tube((1, 0, 0), (1, 0, 1), radius, rng=rng)])
    surface += rng.normal(0, 0.0047, surface.shape)
    axis = np.column_stack([np.zeros(67), np.zeros(67), np.linspace(0, 1, 67)])
    parent = np.arange(-1, 133)
    parent[67] = 0
    nodes = np.vstack([axis, axis + [1, 0.001, 0]])
    skeleton = Skeleton(nodes, parent, np.zeros(134), np.ones(134))
    fitted = fit_axis_radii(skeleton, surface, spacing=0.015, max_radius=0.08)
    assert np.median(fitted.radius[70:131]) == pytest.approx(radius, abs=0.001)
    assert np.median(fitted.radius[3:64]) == pytest.approx(0.04, abs=0.0005)
