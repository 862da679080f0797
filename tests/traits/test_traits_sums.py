"""Tests of the numbers and sums over a tree's axes."""

import numpy as np
import pytest

from cherrypicker.geometry.error_terms import FACTORS
from cherrypicker.traits.sums import AxisSums, draw_unfound

N_SAMPLES = 4000


def axis_row(order=1, length=0.2):
    return {"order": order, "length_m": length, "volume_m3": 1e-5, "mean_diameter_m": 0.008}


def drawn(n_points, p_exists=1.0):
    n_points = np.array(n_points, dtype=np.float64)
    there = np.full(len(n_points), p_exists)
    return draw_unfound(n_points, there, N_SAMPLES, np.random.default_rng(0))


def test_as_many_are_missed_as_the_chance_to_be_found_tells():
    """Of h points half are found, so one is missed for each; h differs from draw to draw."""
    half = FACTORS["half_found"]
    assert drawn([half, 4 * half, 1e9, np.inf]).mean(axis=0) == pytest.approx(
        [1.0, 0.25, 0.0, 0.0], abs=0.08
    )
    together = drawn([half] * 200).sum(axis=1)
    assert np.quantile(together, 0.05) < 30
    assert np.quantile(together, 0.95) > 400


def test_axes_that_the_photos_doubt_lower_the_number():
    assert drawn([np.inf] * 10, 0.9).sum(axis=1).mean() == pytest.approx(-1.0, abs=0.1)


def test_what_is_none_stands_for_no_others():
    half = FACTORS["half_found"]
    assert (drawn([half] * 3, 0.0) == -1).all()
    assert drawn([half], 0.5).mean() == pytest.approx(0.0, abs=0.1)


def test_what_photos_show_beyond_the_skeleton_raises_the_upper_end():
    rows = [axis_row(order=0, length=2.0), *(axis_row() for _ in range(40))]
    unfound = drawn([np.inf] * len(rows))[:200]
    all_seen, some_lacks = (AxisSums(rows, unfound, lacks, 0.001, 0.0) for lacks in (0.0, 0.8))
    sure, lacking = all_seen.length(), some_lacks.length()
    assert sure.value == lacking.value == pytest.approx(10.0)
    assert lacking.ends[0] == sure.ends[0]
    assert lacking.ends[1] > 10.8 > sure.ends[1]
    trunk = some_lacks.order == 0
    assert some_lacks.number(trunk).ends == (1.0, 1.0)
    assert some_lacks.length(trunk).ends == all_seen.length(trunk).ends
    assert some_lacks.volume().ends == all_seen.volume().ends
    assert some_lacks.number(~trunk & trunk).ends is None


def test_no_scatter_is_no_error_of_the_volume_and_the_scale_errs_by_its_power():
    rows = [axis_row(order=0), axis_row()]
    sums = AxisSums(rows, drawn([np.inf, np.inf])[:200], 0.0, None, 0.5)
    assert sums.volume().se is None
    assert sums.number().terms["scale"] == 0.0
    assert sums.length().terms["scale"] == pytest.approx(0.5 * 0.4)
    assert sums.by_order()["n_branches_by_order"] == {"0": 1, "1": 1}
