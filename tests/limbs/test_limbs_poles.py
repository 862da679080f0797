"""Poles: tubes as straight and even as no wood, wherever on a limb."""

import numpy as np
import pytest

from cherrypicker.limbs.poles import pole_rows
from cherrypicker.limbs.tubes import Tube

SPACING = 0.004


def _surface(rng, start, stop, first, last, n=4000):
    """Points of a cone's surface, its radii (m) first and last, with 1 mm of noise."""
    start, stop = np.array(start, float), np.array(stop, float)
    share, angle = rng.random(n), rng.uniform(0, 2 * np.pi, n)
    along = (stop - start) / np.linalg.norm(stop - start)
    across = np.linalg.svd(along[None])[2][1:]
    around = np.cos(angle)[:, None] * across[0] + np.sin(angle)[:, None] * across[1]
    places = (
        start + share[:, None] * (stop - start) + (first + share * (last - first))[:, None] * around
    )
    return places + rng.normal(scale=0.001, size=(n, 3))


def _tube(*corners, radii, step=0.01):
    """A tube from corner to corner with linear radii."""
    corners = np.array(corners, float)
    way = np.append(0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    at = np.arange(0, way[-1], step)
    nodes = np.column_stack([np.interp(at, way, column) for column in corners.T])
    return Tube(nodes, np.interp(at, way, radii))


def test_a_limb_that_leads_from_a_branch_into_a_post_holds_a_pole_with_all_of_its_pieces():
    rng = np.random.default_rng(0)
    post = _surface(rng, (0, 0, 0), (0, 0, 2), 0.025, 0.025, 12_000)
    post = post[(post[:, 2] < 0.6) | (post[:, 2] > 0.9)]  # a part of it is hidden
    branch = _surface(rng, (0.02, 0, 1.4), (0.8, 0, 1.6), 0.012, 0.006)
    points = np.vstack([post, branch])
    tube = _tube((0, 0, 1.0), (0, 0, 1.5), (0.8, 0, 1.6), radii=[0.025, 0.025, 0.006])
    found = np.zeros(len(points), bool)
    found[pole_rows(points, tube, SPACING)] = True
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
    assert not len(pole_rows(points, tube, SPACING))


def test_a_stretch_that_looks_even_to_the_tube_is_none_where_its_points_are_not():
    rng = np.random.default_rng(2)
    points = _surface(rng, (0, 0, 0), (0, 0, 2), 0.03, 0.01)
    tube = _tube((0, 0, 0.6), (0, 0, 1.2), radii=[0.021, 0.021])
    assert not len(pole_rows(points, tube, SPACING))
    few = points[rng.choice(len(points), 60, replace=False)]
    assert not len(pole_rows(few, tube, SPACING))
