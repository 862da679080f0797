"""Ways over the wood, from which rings are cut."""

import numpy as np
import pytest

from cherrypicker.geometry.neighbors import Neighbors
from cherrypicker.limbs.rings import BAND, N_NEIGHBORS, ways_over_wood


def test_only_what_no_wood_joins_is_crossed_within_the_stem():
    """An arm that bends out and back, both ends called stem, with its middle there or hidden."""
    spacing, turn = 0.01, np.linspace(0, np.pi, 60)
    low = np.column_stack([np.zeros((40, 2)), np.arange(40) * spacing])
    bend = np.column_stack([0.19 * np.sin(turn), np.zeros(60), 0.6 - 0.2 * np.cos(turn)])
    points = np.vstack([low, bend, low + [0, 0, 0.81]])
    stem = (points[:, 2] < 0.395) | (points[:, 2] > 0.805)
    ways = ways_over_wood(points, Neighbors(points, N_NEIGHBORS), spacing, stem)
    assert ways.height[-1] * BAND * spacing == pytest.approx(0.8 + 0.6, abs=0.1)  # along the bend
    seen = (np.arange(len(points)) < 50) | (np.arange(len(points)) >= 90)
    hidden = points[seen], Neighbors(points[seen], N_NEIGHBORS), spacing, stem[seen]
    ends = (ways_over_wood(*hidden, gap).height[-1] for gap in (0.5, 0.3))
    straight, dear = (end * BAND * spacing for end in ends)
    assert straight == pytest.approx(1.2, abs=0.05)  # at no more than its length
    assert dear > 5.0, "what lies farther off is no piece of the stem"
