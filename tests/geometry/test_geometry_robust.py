"""Numbers that robust fits share."""

import numpy as np
import pytest

from cherrypicker.geometry.robust import weighted_median


@pytest.mark.parametrize("seed", range(8))
def test_a_weighted_median_is_the_first_value_up_to_which_half_of_the_weights_are(seed):
    """Of values that occur twice too, and of some that count for nothing."""
    rng = np.random.default_rng(seed)
    values, counts = rng.normal(size=60).round(1), rng.integers(seed % 2, 9, 60)
    for n in range(2, 61):
        order = np.argsort(values[:n], kind="stable")
        total = np.cumsum(counts[:n][order])
        found = weighted_median(values[:n], counts[:n])
        assert found == values[:n][order][np.searchsorted(total, total[-1] / 2)]
