"""Numbers that robust fits share."""

import numpy as np
import pytest

from cherrypicker.geometry.robust import RunningMedian


@pytest.mark.parametrize("seed", range(8))
def test_a_running_median_is_that_of_all_values_so_far(seed):
    """Of values that occur twice too, and of some that count for nothing."""
    rng = np.random.default_rng(seed)
    values, counts = rng.normal(size=60).round(1), rng.integers(seed % 2, 9, 60)
    running = RunningMedian()
    for n, (value, count) in enumerate(zip(values, counts, strict=True), 1):
        running.add(float(value), int(count))
        order = np.argsort(values[:n], kind="stable")
        total = np.cumsum(counts[:n][order])
        assert running.value == values[:n][order][np.searchsorted(total, total[-1] / 2)]
