"""Tests of the evidence for short limbs."""

import numpy as np
import pytest

from cherrypicker.limbs.evidence import points_that_err_together, tell_limb
from cherrypicker.limbs.tubes import Tube

NOISE = 0.001


def limb(length, n_points, rng, start=0.02):
    """Points of a shoot of 3 mm radius that leaves a stem of 2 cm, and the tubes of both."""
    stem = Tube(np.array([[0, 0, -0.5], [0, 0, 0.5]]), np.array([0.02, 0.02]))
    shoot = Tube(np.array([[0, 0, 0], [0.02 + length, 0, 0]]), np.array([0.003, 0.003]))
    angle = rng.uniform(0, 2 * np.pi, n_points)
    along = rng.uniform(start, 0.02 + length, n_points)
    points = np.stack([along, 0.003 * np.cos(angle), 0.003 * np.sin(angle)], axis=1)
    return points + rng.normal(0, NOISE, points.shape), shoot, stem


def test_a_shoot_is_told_and_one_that_hangs_on_nothing_is_not():
    rng = np.random.default_rng(0)
    points, shoot, stem = limb(0.03, 12, rng)
    assert tell_limb(points, shoot, stem, start=0.02, noise=NOISE, together=1.0)
    beyond = points + [0.1, 0, 0]
    shoot.nodes[-1, 0] += 0.1
    assert not tell_limb(beyond, shoot, stem, start=0.02, noise=NOISE, together=1.0)


def test_noise_of_the_parent_is_no_limb():
    rng = np.random.default_rng(1)
    points, shoot, stem = limb(0.002, 30, rng, start=0.018)
    assert not tell_limb(points, shoot, stem, start=0.02, noise=2 * NOISE, together=1.0)


def test_points_that_err_together_tell_less():
    rng = np.random.default_rng(2)
    points, shoot, stem = limb(0.03, 12, rng)
    told = [
        tell_limb(points, shoot, stem, start=0.02, noise=NOISE, together=together)
        for together in (1.0, 12.0)
    ]
    assert told == [True, False]


@pytest.mark.parametrize(("cell", "low", "high"), [(0.0, 1.0, 1.5), (0.1, 15.0, 40.0)])
def test_how_many_points_err_together(cell, low, high):
    """Independent errors, and errors that the points of a patch of about 40 share."""
    rng = np.random.default_rng(3)
    points = np.append(rng.uniform(0, 1, (4000, 2)), np.zeros((4000, 1)), axis=1)
    residual = rng.normal(0, NOISE, 4000)
    if cell:
        patch = (points[:, :2] // cell).astype(int)
        residual = rng.normal(0, NOISE, (10, 10))[patch[:, 0], patch[:, 1]]
    assert low <= points_that_err_together(points, residual) <= high


def test_few_points_are_taken_to_err_by_themselves():
    assert points_that_err_together(np.zeros((5, 3)), np.ones(5)) == 1.0
