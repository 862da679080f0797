"""Two scans of one tree: what is said of them, on draws whose spread is known."""

import math

import numpy as np
import pytest
from scipy.stats import ttest_ind

from cherrypicker.accuracy.repeatability import Pair, repeatability, trees_to_show

WITHIN, BETWEEN, MEAN = 2.0, 10.0, 100.0


@pytest.fixture(scope="module")
def many():
    rng = np.random.default_rng(3)
    tree = rng.normal(MEAN, BETWEEN, 4000)
    first, second = (tree + rng.normal(0.0, WITHIN, 4000) for _ in range(2))
    half = 1.6449 * math.sqrt(2) * WITHIN
    return [Pair("a", a, b + 0.5, half) for a, b in zip(first, second, strict=True)]


def test_spreads_within_and_between_trees_are_found(many):
    item = repeatability(many)
    assert item.n_pairs == 4000 and item.mean == pytest.approx(MEAN, rel=0.01)
    assert item.bias == pytest.approx(0.5, abs=0.15)
    assert item.within_sd == pytest.approx(WITHIN, rel=0.04)
    assert item.within_cv == pytest.approx(WITHIN / MEAN, rel=0.06)
    assert item.between_cv == pytest.approx(BETWEEN / MEAN, rel=0.04)
    apart = np.abs([pair.second - pair.first - item.bias for pair in many])
    assert np.mean(apart <= item.repeatability) == pytest.approx(0.95, abs=0.015)
    assert item.n_covered / item.n_intervals == pytest.approx(0.9, abs=0.02)
    assert item.low < item.bias < item.high


def test_the_limit_of_few_pairs_holds(many):
    held = [repeatability(many[at : at + 4]).within_sd_high >= WITHIN for at in range(0, 4000, 4)]
    assert np.mean(held) == pytest.approx(0.95, abs=0.025)


def test_one_pair_tells_neither_limits_nor_the_trees():
    item = repeatability([Pair("a", 3.0, 3.2, None)])
    assert item.within_sd == pytest.approx(0.2 / math.sqrt(2))
    assert item.within_sd_high > 10 * item.within_sd
    assert item.low is item.high is item.between_cv is None
    assert item.n_intervals == 0


def test_what_may_be_zero_has_no_share():
    item = repeatability([Pair("a", 0.0, 2.0, None), Pair("b", 0.0, 0.0, None)])
    assert item.within_cv is None and item.within_sd > 0


def test_so_many_trees_show_the_difference():
    cv, difference = 0.12, 0.05
    n = trees_to_show(difference, cv)
    rng = np.random.default_rng(0)
    groups = [rng.normal(mean, cv, (4000, n)) for mean in (1.0, 1.0 + difference)]
    found = ttest_ind(*groups, axis=1).pvalue < 0.05
    assert found.mean() == pytest.approx(0.8, abs=0.02)
    assert trees_to_show(0.5, 0.01) == 2  # a spread needs two
