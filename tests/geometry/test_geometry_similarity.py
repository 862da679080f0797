"""The similarity of points and others is found, and what it leaves."""

import numpy as np
import pytest
from scan_scene import rotation_about

from cherrypicker.geometry.similarity import fit_similarity


def test_similarity_is_found():
    rng = np.random.default_rng(0)
    points = rng.standard_normal((10, 3))
    points -= points.mean(axis=0)
    turn = rotation_about([1, 2, 3], 70)
    scale, found, left, size = fit_similarity(points + 5, 1.7 * points @ turn.T + [1, 2, 3])
    assert scale == pytest.approx(1.7)
    np.testing.assert_allclose(found, turn, atol=1e-9)
    assert left == pytest.approx(0, abs=1e-9)
    assert size == pytest.approx(np.linalg.norm(points))
