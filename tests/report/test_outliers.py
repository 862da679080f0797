"""Who stands apart from the rest of a batch."""

import numpy as np
import pytest

from cherrypicker.report.outliers import FEWEST, off_the_line, outliers


def named(values):
    return [each.tree for each in outliers({str(i): v for i, v in enumerate(values)})]


def test_the_score_is_that_of_iglewicz_and_hoaglin():
    values = np.exp([0.0, 0.1, -0.1, 0.2, -0.2, 0.05, -0.05, 0.15, -0.15, 2.0])
    (found,) = outliers({str(i): v for i, v in enumerate(values)})
    logs = np.log(values / np.median(values))
    score = (logs - np.median(logs)) / (1.4826 * np.median(np.abs(logs - np.median(logs))))
    assert found.tree == "9"
    assert found.score == pytest.approx(score[9])
    assert found.usual == pytest.approx(np.median(values))


def test_half_as_large_is_as_far_off_as_twice_as_large():
    usual = [0.9, 0.95, 1.0, 1.0, 1.05, 1.1, 0.98, 1.02, 1.0]
    assert named([*usual, 2.0]) == named([*usual, 0.5]) == ["9"]


def test_few_trees_equal_trees_and_normal_trees_have_none_named():
    assert named([1.0] * (FEWEST - 2) + [50.0]) == []
    assert named([3.0] * 20 + [4.0]) == []
    assert len(named(np.exp(0.2 * np.random.default_rng(3).standard_normal(1000)))) < 5


def test_a_size_of_zero_is_named_first():
    assert named([0.0, 9.0, *np.linspace(0.9, 1.1, 12)]) == ["0", "1"]


def test_a_tree_that_lacks_wood_is_off_the_line_of_the_others():
    rng = np.random.default_rng(0)
    x = np.exp(rng.normal(3.5, 0.5, 40))
    y = 0.6 * x**0.9 * np.exp(rng.normal(0, 0.1, 40))
    y[7] *= 0.3
    sizes, others = ({str(i): float(v) for i, v in enumerate(each)} for each in (x, y))
    line, (found,) = off_the_line(sizes, others)
    factor, power = line
    assert factor * 35.0**power == pytest.approx(0.6 * 35.0**0.9, rel=0.05)
    assert power == pytest.approx(0.9, abs=0.1)
    assert found.tree == "7"
    assert found.score < 0
    assert found.value / found.usual == pytest.approx(0.3, rel=0.3)
