"""Points that were shared out among the trees of a row, beside their true trees."""

import numpy as np
import pytest

from cherrypicker_lab.orchard.scene.mesh import NO_TREE
from cherrypicker_lab.traits.rows import share_scores


def test_wood_of_another_tree_is_wrong_and_ground_is_merely_no_wood():
    owner = np.array([2, 2, 2, 2, 1, 1, 0])
    tree = np.array([0, 0, 1, NO_TREE, 1, 1, 1])
    feet = np.array([[0.0, 0.0], [2.0, 0.0]])
    first, second = share_scores(owner, tree, feet[::-1], feet)
    assert (first["number"], second["number"]) == (2, 1)
    assert first["iou"] == pytest.approx(2 / 4) and first["wrong"] == pytest.approx(1 / 4)
    assert second["iou"] == pytest.approx(2 / 4) and second["wrong"] == 0.0


def test_a_tree_that_nobody_found_has_no_number():
    feet = np.array([[0.0, 0.0], [2.0, 0.0]])
    rows = share_scores(np.ones(4, int), np.array([0, 0, 1, 1]), feet[:1] + 0.1, feet)
    assert [row["number"] for row in rows] == [1, 0] and rows[1]["iou"] == 0.0
