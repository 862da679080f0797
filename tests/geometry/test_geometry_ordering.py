"""Compiled medians and look-ups against NumPy's."""

import numpy as np
import pytest

from cherrypicker.geometry.ordering import first_not_below, median


@pytest.fixture(params=[1, 2, 3, 4, 5, 12, 13, 100, 1001])
def values(request):
    rng = np.random.default_rng(request.param)
    return rng.choice([rng.normal(size=request.param), rng.integers(0, 4, request.param)])


def test_medians(values):
    assert median(values.copy()) == np.median(values)
    for ordered in (np.sort(values), np.sort(values)[::-1].copy()):
        assert median(ordered) == np.median(values)


def test_a_nan_makes_the_median_one(values):
    values[len(values) // 2] = np.nan
    assert np.isnan(median(values))


def test_rows_not_below(values):
    values.sort()
    for wanted in (-9.0, values[0], values.mean(), values[-1], np.nextafter(values[-1], 9.0)):
        assert first_not_below(values, wanted) == np.searchsorted(values, wanted)


def test_rows_of_whole_numbers():
    key = np.array([1, 1, 4, 9])
    assert [first_not_below(key, wanted) for wanted in (0, 1, 2, 9, 10)] == [0, 0, 2, 3, 4]
    assert first_not_below(key[:0], 3) == 0
