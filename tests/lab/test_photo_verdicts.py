"""What the laboratory makes of what photos tell of axes."""

import pytest

from cherrypicker_lab.photo_verdicts import reliability


def test_what_is_told_stands_beside_what_is_true_by_length():
    axes = [(0.95, 1.0, 3.0), (0.85, 0.6, 1.0), (1.0, 1.0, 0.0), (0.1, 0.0, 2.0)]
    bins = reliability(axes)
    assert [n for n, _, _ in bins] == [1, 0, 0, 0, 3]
    assert bins[4][1:] == pytest.approx((0.925, 0.9))
    assert bins[0][1:] == pytest.approx((0.1, 0.0))
