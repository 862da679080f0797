"""Limbs joined to one tree."""

import numpy as np
import pytest

from cherrypicker.limbs.growth import Limb
from cherrypicker.limbs.joints import back_to, join_limbs
from cherrypicker.limbs.tubes import Tube

SPACING = 0.008


def straight(start, end, radius, parent, n=20):
    nodes = np.asarray(start) + np.linspace(0, 1, n)[:, None] * np.subtract(end, start)
    return Limb(Tube(nodes.astype(float), np.full(n, radius)), parent)


STEM = straight((0, 0, 0), (0, 0, 1), 0.05, -1)


def junctions(points, parent):
    return points[np.flatnonzero(np.bincount(parent[1:], minlength=len(points)) > 1)]


def test_a_limb_meets_its_parent_in_its_straight_continuation():
    # from the surface of the stem at 45 degrees: it comes from 5 cm farther down
    limb = straight((0.05, 0, 0.5), (0.35, 0, 0.8), 0.01, 0)
    points, parent, radius, owner = join_limbs([STEM, limb], SPACING, 0.01)
    assert (parent[1:] < np.arange(1, len(points))).all() and parent[0] == -1
    (joint,) = junctions(points, parent)
    np.testing.assert_allclose(joint, [0, 0, 0.45], atol=0.01)
    assert np.bincount(owner).argmax() == 0 and set(owner) == {0, 1}
    np.testing.assert_allclose(radius[owner == 1], 0.01)
    assert np.linalg.norm(np.diff(points[owner == 0], axis=0), axis=1).max() < 0.0101


def test_limbs_from_one_place_share_a_node_and_others_do_not():
    whorl = [
        straight((0.05 * x, 0.05 * y, 0.5 + z), (x, y, 0.6), 0.01, 0)
        for x, y, z in ((1, 0, 0), (-0.5, 0.9, 0.012), (-0.5, -0.9, -0.012))
    ]
    high = straight((0, 0.05, 0.8), (0, 0.4, 0.85), 0.01, 0)
    points, parent, *_ = join_limbs([STEM, *whorl, high], SPACING, 0.01)
    found = junctions(points, parent)
    assert len(found) == 2
    assert found[:, 2] == pytest.approx(sorted(found[:, 2]))
    assert np.bincount(parent[1:]).max() == 4


def test_a_stem_alone_is_a_path():
    points, parent, *_ = join_limbs([STEM], SPACING, 0.02)
    np.testing.assert_array_equal(parent, np.arange(-1, len(points) - 1))


@pytest.mark.parametrize("azimuth", range(0, 360, 45))
def test_a_limb_goes_back_to_its_parent_whichever_way_it_points(azimuth):
    out = np.array([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), 0.0])
    limb = straight(0.15 * out + [0, 0, 0.5], 0.6 * out + [0, 0, 0.5], 0.01, 0).tube
    back = back_to(STEM.tube, limb, SPACING)
    np.testing.assert_allclose(back.nodes[0], [0, 0, 0.5], atol=0.02)
    np.testing.assert_array_equal(back.nodes[1:], limb.nodes)
