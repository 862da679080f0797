"""White rings on stems are told by their brightness alone; paint and lichen are none."""

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker.limbs.tubes import Tube
from cherrypicker.segmentation.white_rings import ring_points
from cherrypicker_lab.training.segmentation.scenes import hidden_bark

RADIUS = 0.03


@pytest.fixture
def stem():
    """Points and colours of a stem of 1 m, and its tube; one side is sunlit."""
    rng = np.random.default_rng(0)
    z, angle = rng.uniform(0, 1, 12000), rng.uniform(-np.pi, np.pi, 12000)
    radius = RADIUS + rng.normal(0, 0.001, len(z))
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
    light = 0.35 + 0.15 * np.cos(angle) + rng.normal(0, 0.05, len(z))
    colors = np.clip(light[:, None] * [1.05, 1.0, 0.9], 0, 1)
    places = np.column_stack([np.zeros((201, 2)), np.linspace(0, 1, 201)])
    return points, colors, Tube(places, np.full(201, RADIUS))


def _whiten(colors, rows, tone=(1.6, 1.6, 1.6)):
    colors = colors.copy()
    colors[rows] = np.clip(colors[rows] * tone, 0, 1)
    return colors


@pytest.mark.parametrize("width", [0.03, 0.06])
def test_a_white_ring_is_found_to_its_edges(stem, width):
    points, colors, tube = stem
    ring = np.abs(points[:, 2] - 0.45) < width / 2
    found = ring_points(points, _whiten(colors, ring), tube)
    assert found[ring].mean() > 0.8
    assert found[~ring].sum() < 0.3 * ring.sum()


def test_bark_paint_and_one_sided_lichen_are_no_rings(stem):
    points, colors, tube = stem
    assert not ring_points(points, colors, tube).any()
    painted = _whiten(colors, points[:, 2] < 0.4)
    assert not ring_points(points, painted, tube).any()
    lichen = (np.abs(points[:, 2] - 0.5) < 0.02) & (points[:, 0] > 0)
    assert not ring_points(points, _whiten(colors, lichen), tube).any()


def test_a_coloured_band_is_no_white_ring(stem):
    points, colors, tube = stem
    band = np.abs(points[:, 2] - 0.45) < 0.02
    red = _whiten(colors, band, (2.4, 1.3, 1.3))
    assert not ring_points(points, red, tube).any()


def test_bark_under_a_ring_is_hidden_and_other_wood_is_not():
    labels = np.array([Label.CALIBRATION_UNIT, Label.TRUNK, Label.TRUNK, Label.GROUND], np.uint8)
    points = np.array([[0.034, 0, 0.5], [0.030, 0, 0.5], [0.030, 0, 0.6], [0.034, 0, 0.501]])
    assert hidden_bark(points, labels).tolist() == [False, True, False, False]
    assert not hidden_bark(points[1:], labels[1:]).any()
