"""The compiled median against NumPy's."""

import numpy as np
import pytest

from cherrypicker.geometry.ordering import median


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
