"""The judge and the table of the benchmark of two dates, on known answers."""

import numpy as np
import pytest

from cherrypicker.errors import StageError
from cherrypicker_lab.orchard.grow.seasons import NEW
from cherrypicker_lab.series.judge import true_pairs
from cherrypicker_lab.series.pairs import KINDS, make_date
from cherrypicker_lab.series.tables import write_table


def test_the_dates_of_a_seed_are_those_of_one_tree():
    dates = {kind: make_date(7103, kind)[1] for kind in ("first", "pruned", "both")}
    assert dates["pruned"].cuts == dates["both"].cuts
    assert set(dates["pruned"].node_numbers) < set(dates["first"].node_numbers)


def test_axes_are_the_same_that_share_most_of_their_old_wood():
    axis = np.array([0, 0, 0, 1, 1, 1, 1, 2])
    numbers = np.array([0, 1, 2, 3, 4, 5, 6, 7])
    later_axis = np.array([0, 0, 1, 1, 1, 1, 1, 2])
    later_numbers = np.array([0, 1, 2, 3, 4, 5, NEW, 9])
    assert true_pairs(axis, numbers, later_axis, later_numbers) == {(0, 0), (1, 1)}


def test_the_table_sums_and_names_the_worst():
    pair = {
        "axes_10cm": {"n_true": 10, "n_found": 10, "n_right": 10},
        "cuts": {"n_true": 8, "n_found": 8, "n_right": 7},
        **dict.fromkeys(("length_m", "true_new_length_m", "new_length_m"), 10.0),
        **dict.fromkeys(("removed_length_m", "true_removed_length_m"), 2.0),
        **dict.fromkeys(("true_removed_volume_m3", "seen_removed_volume_m3"), 1.0),
        **{"removed_volume_m3": 1.1, "false_removed_length_m": 0.05, "false_new_length_m": 0.0},
    }
    none = {**pair, "cuts": dict.fromkeys(pair["cuts"], 0), "false_removed_length_m": 0.0}
    pairs = {kind: none if kind in ("same", "grown") else pair for kind in KINDS}
    other = {**pairs, "both": {**pair, "removed_volume_m3": 0.95}}
    reports = [{"seed": n, "walk": "seen", "pairs": each} for n, each in enumerate((pairs, other))]
    table = write_table(reports)
    assert "2 trees, seeds 0 to 1" in table
    (row,) = [line for line in table.splitlines() if line.startswith("| both")]
    assert "1.000 (1.000)" in row
    assert "14 of 16, 16" in row and "+2.5 % (+10.0 %)" in row and "0.50 % (0.50 %)" in row
    with pytest.raises(StageError):
        write_table([])
