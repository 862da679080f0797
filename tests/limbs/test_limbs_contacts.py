"""Limbs that were cut where branches touch."""

import numpy as np
import pytest
from test_limbs_joints import SPACING, STEM, straight

from cherrypicker.limbs.contacts import join_at_contacts

# Two branches of the stem that cross at (0.3, 0, 0.5); the second goes on to (0.5, 0, 0.7)
LEVEL = straight((0.05, 0, 0.5), (0.6, 0, 0.5), 0.01, 0)
RISING = straight((0.05, 0, 0.25), (0.28, 0, 0.48), 0.008, 0)


def ends(limbs):
    return [tuple(np.round(limb.tube.nodes[[0, -1]].ravel(), 2)) for limb in limbs]


def test_a_branch_goes_on_beyond_the_one_that_it_crosses():
    outer = straight((0.3, 0, 0.5), (0.5, 0, 0.7), 0.006, 1)
    twig = straight((0.4, 0, 0.6), (0.4, 0.2, 0.6), 0.003, 3)
    joined = join_at_contacts([STEM, LEVEL, RISING, outer, twig], SPACING)
    assert [limb.parent for limb in joined] == [-1, 0, 0, 2]
    assert ends(joined)[2] == (0.05, 0, 0.25, 0.5, 0, 0.7)
    step = np.linalg.norm(np.diff(joined[2].tube.nodes, axis=0), axis=1)
    assert step.max() < 1.5 * step.min()


def test_what_grew_from_the_outer_part_may_come_before_its_new_parent():
    outer = straight((0.3, 0, 0.5), (0.5, 0, 0.7), 0.006, 1)
    twig = straight((0.4, 0, 0.6), (0.4, 0.2, 0.6), 0.003, 2)
    joined = join_at_contacts([STEM, LEVEL, outer, twig, RISING], SPACING)
    assert [limb.parent for limb in joined] == [-1, 0, 0, 2]
    assert ends(joined)[3] == ends([twig])[0]


def test_ways_that_met_in_the_middle_of_a_branch_are_one():
    met = straight((0.3, 0, 0.7), (0.1, 0, 0.7), 0.006, 1)
    upright = straight((0.3, 0, 0.5), (0.3, 0, 1.0), 0.01, 0)
    long = straight((-0.5, 0, 0.7), (0.08, 0, 0.7), 0.006, 0)
    joined = join_at_contacts([STEM, upright, met, long], SPACING)
    assert [limb.parent for limb in joined] == [-1, 0, 0]
    assert ends(joined)[2] == (-0.5, 0, 0.7, 0.3, 0, 0.7)


@pytest.mark.parametrize(
    "other",
    [
        straight((0.3, 0, 0.5), (0.3, 0.3, 0.5), 0.006, 1),  # not in line
        straight((0.45, 0, 0.65), (0.6, 0, 0.8), 0.006, 1),  # too far off
        straight((0.5, 0, 0.7), (0.3, 0, 0.5), 0.006, 0),  # an arch from the stem to the stem
    ],
    ids=["aside", "far", "arch"],
)
def test_what_is_no_piece_of_an_end_stays(other):
    limbs = [STEM, LEVEL, RISING, other]
    assert ends(join_at_contacts(list(limbs), SPACING)) == ends(limbs)
