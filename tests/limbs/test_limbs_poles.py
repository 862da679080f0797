"""Poles and wires: tubes as straight and even as no wood, wherever on a limb."""

import numpy as np
import pytest
from skeleton_shapes import tube

from cherrypicker.limbs.poles import find_poles
from cherrypicker.limbs.tubes import Tube

SPACING = 0.004


def _surface(rng, start, stop, first, last, density=60_000):
    return tube(start, stop, first, density, rng=rng, end_radius=last, noise=0.001)


def _tube(*corners, radii, step=0.01):
    """A tube from corner to corner with linear radii."""
    corners = np.array(corners, float)
    way = np.append(0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    at = np.arange(0, way[-1], step)
    nodes = np.column_stack([np.interp(at, way, column) for column in corners.T])
    return Tube(nodes, np.interp(at, way, radii))


def test_a_limb_that_leads_from_a_branch_into_a_post_holds_a_pole_with_all_of_its_pieces():
    rng = np.random.default_rng(0)
    post = _surface(rng, (0, 0, 0), (0, 0, 2), 0.025, 0.025)
    post = post[(post[:, 2] < 0.6) | (post[:, 2] > 0.9)]  # a part of it is hidden
    branch = _surface(rng, (0.02, 0, 1.4), (0.8, 0, 1.6), 0.012, 0.006)
    points = np.vstack([post, branch])
    tube = _tube((0, 0, 1.0), (0, 0, 1.5), (0.8, 0, 1.6), radii=[0.025, 0.025, 0.006])
    found = np.zeros(len(points), bool)
    (pole,) = find_poles(points, tube, SPACING)
    found[pole.rows(points)] = True
    assert found[: len(post)].mean() > 0.99
    assert found[len(post) :].mean() < 0.05


@pytest.mark.parametrize(
    "radii, corners",
    [
        pytest.param((0.03, 0.02), [(0, 0, 0), (0, 0, 1.5)], id="it thins"),
        pytest.param((0.02, 0.02), [(0, 0, 0), (0.05, 0, 0.25), (0, 0, 0.5)], id="it bends"),
        pytest.param((0.03, 0.03), [(0, 0, 0), (0, 0, 0.3)], id="it is short"),
    ],
)
def test_wood_is_no_pole(radii, corners):
    rng = np.random.default_rng(1)
    points = np.vstack(
        [_surface(rng, a, b, *radii) for a, b in zip(corners[:-1], corners[1:], strict=True)]
    )
    tube = _tube(*corners, radii=np.linspace(*radii, len(corners)))
    assert not find_poles(points, tube, SPACING)


def test_a_stretch_that_looks_even_to_the_tube_is_none_where_its_points_are_not():
    rng = np.random.default_rng(2)
    points = _surface(rng, (0, 0, 0), (0, 0, 2), 0.03, 0.01)
    tube = _tube((0, 0, 0.6), (0, 0, 1.2), radii=[0.021, 0.021])
    assert not find_poles(points, tube, SPACING)
    few = points[rng.choice(len(points), 60, replace=False)]
    assert not find_poles(few, tube, SPACING)


def test_a_pole_ends_where_what_lies_beyond_on_its_line_is_not_it():
    """Branches cross the line of a post above it, where it would be neither even nor straight."""
    rng = np.random.default_rng(5)
    post = _surface(rng, (0, 0, 0), (0, 0, 2), 0.025, 0.025)
    beyond = [
        _surface(rng, (0.0, -0.5, z), (0.0, 0.5, z + 0.1), 0.005, 0.005) for z in (2.3, 2.6, 3.0)
    ]
    (pole,) = find_poles(
        np.vstack([post, *beyond]), _tube((0, 0, 0.5), (0, 0, 1.6), radii=[0.025, 0.025]), SPACING
    )
    assert pole.length == pytest.approx(2.0, abs=0.03)
    assert len(pole.rows(post)) > 0.99 * len(post)


@pytest.mark.parametrize(
    "seed, radius, stem, density, free, share",
    [
        pytest.param(6, 0.03, (-0.06, 0.03, 0.03), 100_000, (1.1, 1.9), 0.99, id="wood leans"),
        # However dense it is: from the free top alone
        pytest.param(8, 0.02, (-0.03, 0.02, 0.012), 400_000, (1.6, 1.95), 0.95, id="it is dense"),
    ],
)
def test_a_post_that_a_stem_touches_is_straight(seed, radius, stem, density, free, share):
    """The stem's points within its reach lie on one side of it, along some of its length."""
    rng = np.random.default_rng(seed)
    post = _surface(rng, (0, 0, 0), (0, 0, 2), radius, radius)
    x, *radii = stem
    beside = _surface(rng, (x, 0, 0), (x, 0, 1), *radii, density=density)
    tube = _tube(*((0, 0, z) for z in free), radii=[radius, radius])
    (pole,) = find_poles(np.vstack([post, beside]), tube, SPACING)
    assert len(pole.rows(post)) > share * len(post)
    assert pole.along == pytest.approx([0, 0, np.sign(pole.along[2])], abs=0.002)


def test_points_at_the_ends_of_a_stretch_alone_tell_no_pole():
    rng = np.random.default_rng(4)
    points = _surface(rng, (0, 0, 0), (0, 0, 1), 0.02, 0.02)
    ends = points[np.abs(np.abs(points[:, 2] - 0.5) - 0.46) < 0.02]
    assert len(ends) > 64
    assert not find_poles(ends, _tube((0, 0, 0), (0, 0, 1), radii=[0.02, 0.02]), SPACING)


@pytest.fixture(scope="module")
def crown():
    """A stem, a shoot of even thickness on it, and a wire that passes both, with a piece hidden."""
    rng = np.random.default_rng(3)
    wire = _surface(rng, (-1.2, 0.03, 1.0), (1.4, 0.06, 1.01), 0.001, 0.001, 360_000)
    wire[:, 2] -= 0.002 * (1 - ((wire[:, 0] - 0.1) / 1.3) ** 2)  # it sags
    wire = wire[(wire[:, 0] < 0.5) | (wire[:, 0] > 0.7)]
    stem = _surface(rng, (0, 0, 0), (0.02, 0, 2), 0.03, 0.012)
    shoot = _surface(rng, (0.02, 0, 1.2), (0.2, 0.9, 1.7), 0.003, 0.003, 170_000)
    return wire, stem, shoot


def test_a_wire_through_a_crown_is_found_whole_from_a_limb_that_turns_into_it(crown):
    points = np.vstack(crown)
    tube = _tube((0.02, 0, 0.8), (0.02, 0.045, 1.0), (0.5, 0.05, 1.005), radii=[0.01, 0.001, 0.001])
    pole, *_ = find_poles(points, tube, SPACING)
    found = np.zeros(len(points), bool)
    found[pole.rows(points)] = True
    n_wire = len(crown[0])
    assert found[:n_wire].mean() > 0.98
    assert found[n_wire:].mean() < 0.01
    assert pole.is_free(points)
    # Where its last points stray they are its own; what goes on beyond them bears it
    rng, end = np.random.default_rng(5), crown[0][crown[0][:, 0].argmax()]
    strays = rng.normal(end, 0.004, (800, 3))
    twig = _surface(rng, end - [0, 0.1, 0.1], end + [0, 0.1, 0.1], 0.004, 0.004)
    assert pole.is_free(np.vstack([points, strays]))
    assert not pole.is_free(np.vstack([points, twig]))
    assert pole.is_free(np.vstack([points, twig + [0, 0.02, -0.02]]))  # which passes beside it


@pytest.mark.parametrize("angle_deg", [10, 20, 40, 60])
@pytest.mark.parametrize(("radius", "bearer"), [(0.003, 0.003), (0.003, 0.004), (0.004, 0.005)])
def test_a_shoot_hangs_on_a_limb_as_thick_as_itself(radius, bearer, angle_deg):
    rng, angle = np.random.default_rng(6), np.radians(angle_deg)
    end = 0.9 * np.array([np.cos(angle), np.sin(angle), 0.0])
    shoot = _surface(rng, (0, 0, 0), end, radius, radius)
    limb = _surface(rng, (-0.5, 0, 0), (0.5, 0, 0), bearer, bearer)
    points = np.vstack([shoot, limb])
    poles = find_poles(points, _tube(0.2 * end, end, radii=[radius, radius]), SPACING)
    assert not any(pole.is_free(points) for pole in poles)


def test_a_shoot_as_straight_and_even_as_a_wire_hangs_on_its_stem(crown):
    points = np.vstack(crown)
    tube = _tube((0.06, 0.2, 1.311), (0.2, 0.9, 1.7), radii=[0.003, 0.003])
    (pole,) = find_poles(points, tube, SPACING)
    assert not pole.is_free(points)
    for radii in ((0.006, 0.002), (0.004, 0.001)):  # as shoots are, it thins
        rng = np.random.default_rng(4)
        thins = np.vstack([crown[1], _surface(rng, (0.02, 0, 1.2), (0.2, 0.9, 1.7), *radii)])
        assert not find_poles(thins, tube, SPACING)


def test_all_poles_that_a_limb_follows_are_found_however_its_tube_strays():
    """As one that goes up a post and along its wire, at which noise pulls it to and fro."""
    rng = np.random.default_rng(7)
    post = _surface(rng, (0, 0, 0), (0, 0, 2), 0.025, 0.025)
    wire = _surface(rng, (0, 0, 1.5), (3, 0, 1.5), 0.002, 0.002, 100_000)
    corners = [(x, 0.03 * (i % 3 == 1), 1.5) for i, x in enumerate(np.arange(0.1, 2, 0.1))]
    limb = _tube((0, 0, 0.1), (0, 0, 1.5), *corners, radii=np.r_[0.025, 0.025, [0.002] * 19])
    points = np.vstack([post, wire])
    found = find_poles(points, limb, SPACING)
    assert len(found) == 2
    for part in (post, wire):
        assert max(len(pole.rows(part)) for pole in found) > 0.95 * len(part)
