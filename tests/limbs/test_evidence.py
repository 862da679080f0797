"""Tests of the evidence for limbs."""

import numpy as np
import pytest

from cherrypicker.limbs.evidence import design_effect, told_until
from cherrypicker.limbs.growth import LEAST_POINTS
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


def is_told(points, shoot, stem, *, share=1.0, noise=NOISE, effect=1.0, **rival):
    known = {"weight": np.full(len(points), share), "noise": noise, "effect": effect, "reach": 0.01}
    return told_until(points, shoot, stem, **known, **rival) > 0


def test_a_shoot_is_told_and_a_bump_is_not():
    rng = np.random.default_rng(0)
    points, shoot, stem = limb(0.03, 12, rng)
    assert is_told(points, shoot, stem)
    # as far off the tube, and all equally far off the stem: beside it a patch of bark, but a twig
    # where it stands off farther than it is wide, and is no strand of wrong depths
    along = Tube(np.array([[0.03, 0, -0.02], [0.03, 0, 0.02]]), np.array([0.003, 0.003]))
    beside = points.copy()
    beside[:, 2] = np.linspace(-0.015, 0.015, len(beside))
    beside[:, 0] = 0.03 + rng.normal(0, NOISE, len(beside))
    bark = beside.copy()
    bark[:, 1] = rng.permutation(np.linspace(-0.01, 0.01, len(bark)))
    assert not is_told(bark, along, stem)
    assert is_told(beside, along, stem)
    assert not is_told(beside, along, stem, from_photos=True)


def test_what_stands_out_farther_than_the_parent_is_thick_is_no_bump():
    """A short shoot on a thin branch scatters no more than noise does, 2 cm off it."""
    rng = np.random.default_rng(4)
    points, shoot, _ = limb(0.01, 8, rng, start=0.02)
    thin, thick = (
        Tube(np.array([[0, 0, -0.5], [0, 0, 0.5]]), np.full(2, radius)) for radius in (0.003, 0.02)
    )
    assert is_told(points, shoot, thin, noise=0.004)
    assert not is_told(points, shoot, thick, noise=0.004)


@pytest.mark.parametrize("seed", range(5))
def test_a_tube_that_bends_over_air_from_one_stray_point_to_the_next_is_no_limb(seed):
    rng = np.random.default_rng(seed)
    _, _, stem = limb(0.5, 1, rng)
    ahead = np.linspace(0.07, 0.47, 8)
    aside = rng.normal(0, NOISE, (8, 2))

    def told(points, tube):
        return told_until(
            points, tube, stem, weight=np.ones(len(points)), noise=NOISE, effect=1.0, reach=0.01
        )

    def n_told(points):
        nodes = np.vstack([[0.02, 0, 0], points])
        tube = Tube(nodes, np.full(len(nodes), 0.0005))
        return np.count_nonzero(tube.way[1:] <= told(points, tube) + 1e-6)

    assert n_told(np.column_stack([ahead, aside])) == 8
    arc = np.column_stack([np.sin(ahead), np.zeros(8), 1 - np.cos(ahead)])  # of a metre
    assert n_told(arc + np.column_stack([np.zeros(8), aside])) == 8
    # Whose pieces are short beside what tells their places turns for no reason of its own
    near = np.column_stack([0.07 + 0.012 * np.arange(30), rng.normal(0, 2 * NOISE, (30, 2))])
    assert n_told(near) == 30
    strays = np.column_stack([ahead, rng.normal(0, 0.1, (8, 2))])
    assert n_told(strays) < LEAST_POINTS  # two stray points have no bend yet
    # A shoot keeps what is told of it where strays follow its end
    points, shoot, _ = limb(0.05, 12, rng)
    beyond = np.column_stack([0.1 + 0.03 * np.arange(30), rng.normal(0, 0.5, (30, 2))])
    longer = Tube(np.vstack([shoot.nodes, beyond]), np.full(32, 0.003))
    assert told(points, shoot) == np.inf
    # So it does where two lie beside it, which no limb follows
    beside = np.array([[0.1, 0.3, 0.0], [0.13, 0.3, 0.0]])
    straight = Tube(np.array([[0, 0, 0], [0.2, 0, 0]]), np.full(2, 0.003))
    assert 0.05 < told(np.vstack([points, beside]), straight) < 0.08
    assert 0.05 < told(np.vstack([points, beyond]), longer) < np.inf


def test_single_points_beyond_air_are_no_end_of_a_shoot_and_hidden_pieces_are():
    points, shoot, stem = limb(0.05, 200, np.random.default_rng(3))
    beyond = np.array([[0.11, 0.05, 0.0], [0.15, 0.02, 0.0]])
    longer = Tube(np.vstack([shoot.nodes, beyond]), np.full(4, 0.003))

    def told(n_each):
        seen = np.vstack([points, *(place + np.zeros((n_each, 3)) for place in beyond)])
        known = {"weight": np.ones(len(seen)), "noise": NOISE, "effect": 1.0, "reach": 0.01}
        return told_until(seen, longer, stem, **known)

    assert told(1) < 0.08
    assert told(15) == np.inf


def test_what_noise_may_be_takes_more_points_than_what_may_be_a_bump():
    points, shoot, stem = limb(0.02, 12, np.random.default_rng(0))
    assert is_told(points[:6], shoot, stem, effect=5.0)
    assert not is_told(points[:6], shoot, stem, effect=5.0, n_rival=0)
    assert is_told(points, shoot, stem, effect=4.0, n_rival=0)


def test_noise_of_the_parent_is_no_limb():
    rng = np.random.default_rng(1)
    points, shoot, stem = limb(0.002, 30, rng, start=0.018)
    assert not is_told(points, shoot, stem, noise=2 * NOISE)


def test_design_effect_or_are_few_for_their_wood_tell_less():
    points, shoot, stem = limb(0.03, 12, np.random.default_rng(2))
    assert is_told(points, shoot, stem)
    assert not is_told(points, shoot, stem, effect=60.0)
    assert not is_told(points, shoot, stem, share=0.02)


@pytest.mark.parametrize(("cell", "low", "high"), [(0.0, 1.0, 1.5), (0.1, 15.0, 40.0)])
def test_how_many_points_err_together(cell, low, high):
    """Independent errors, and errors that the points of a patch of about 40 share."""
    rng = np.random.default_rng(3)
    points = np.append(rng.uniform(0, 1, (4000, 2)), np.zeros((4000, 1)), axis=1)
    residual = rng.normal(0, NOISE, 4000)
    if cell:
        patch = (points[:, :2] // cell).astype(int)
        residual = rng.normal(0, NOISE, (10, 10))[patch[:, 0], patch[:, 1]]
    assert low <= design_effect(points, residual) <= high


def test_few_points_are_taken_to_err_by_themselves():
    assert design_effect(np.zeros((5, 3)), np.ones(5)) == 1.0


def test_a_limb_that_no_point_is_of_is_not_told():
    stem, shoot = (
        Tube(np.array([[0, 0, 0.0], end]), np.full(2, 0.01)) for end in ((0, 0, 1.0), (1.0, 0, 0))
    )
    nothing = {"weight": np.empty(0), "noise": 0.001, "effect": 1.0, "reach": 0.01}
    assert not told_until(np.empty((0, 3)), shoot, stem, **nothing)


def test_what_lies_in_a_crotch_is_noise_of_the_wood_on_both_sides():
    """Points between a stem and a shoot that leaves it, as far off as a few of theirs are."""
    rng = np.random.default_rng(6)
    along = rng.uniform(0.0, 0.1, 60)
    web = np.stack([0.02 + 0.4 * along, np.zeros(60), along], axis=1)
    web += rng.normal(0, NOISE, web.shape)
    stem = Tube(np.array([[0, 0, -0.5], [0, 0, 0.5]]), np.array([0.02, 0.02]))
    between = Tube(np.array([[0.02, 0, 0], [0.06, 0, 0.1]]), np.full(2, 0.001))
    assert is_told(web, between, stem)
    assert not is_told(web, between, stem, beside=np.abs(rng.normal(0, 2 * NOISE, 60)))


def test_strays_tell_nothing_of_a_shoot_and_make_none():
    rng = np.random.default_rng(7)
    points, shoot, stem = limb(0.03, 30, rng)
    bark = np.stack([np.full(25, 0.02), np.zeros(25), rng.uniform(0, 0.03, 25)], axis=1)
    bark += rng.normal(0, NOISE, bark.shape)
    whisker = Tube(np.array([[0.02, 0, 0], [0.02, 0, 0.03]]), np.full(2, 0.001))
    assert not is_told(bark, whisker, stem)
    for away in (0.05, 0.1, 0.4, 5.0):
        assert is_told(np.vstack([points, [[0.04, 0, away]]]), shoot, stem)
        assert not is_told(np.vstack([bark, [[0.02 + away, 0, 0.01]]]), whisker, stem)
