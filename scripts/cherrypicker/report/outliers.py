"""Trees that stand apart from the rest of their batch, by one rule.

A number stands apart where its modified z-score, 0.6745 times its distance from the median over the
median absolute deviation, is beyond 3.5 (Iglewicz and Hoaglin 1993, How to Detect and Handle
Outliers, ASQC). Sizes of trees are compared by their logarithms: half the median is as far off as
twice the median. Where one size follows another, the number is the distance from the line through
the logarithms of both (Theil 1950 and Sen 1968: the median of the slopes between any two trees).

Of normal numbers the rule names 1 in 60 among 10 trees, 1 in 150 among 20 and 1 in 1600 among 300
(20,000 draws each); Tukey's fences would name 1 in 25, 1 in 43 and 1 in 125.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from statistics import median

LIMIT = 3.5
FEWEST = 10  # trees; among fewer the rule names more than 1 in 60 that belong to the rest
_MAD_SHARE = 0.6745  # of a normal distribution's standard deviation


@dataclass(frozen=True)
class Outlier:
    """One number that stands apart."""

    tree: str
    value: float
    usual: float  # median of all trees, or what the line says of this one
    score: float  # modified z; infinite for a size of zero


@dataclass(frozen=True)
class Line:
    """y = factor * x ** power."""

    factor: float
    power: float

    def at(self, x: float) -> float:
        """Return the line's value."""
        return self.factor * x**self.power


def outliers(values: Mapping[str, float]) -> list[Outlier]:
    """Return the trees whose value stands apart, the farthest first.

    Parameters
    ----------
    values : mapping of str to float
        A size or a count of each tree.
    """
    if len(values) < FEWEST:
        return []
    usual = median(values.values())
    scores = _scores({tree: _log(value / usual) for tree, value in values.items()} if usual else {})
    return _named(scores, values, dict.fromkeys(values, usual))


def off_the_line(x: Mapping[str, float], y: Mapping[str, float]) -> list[Outlier]:
    """Return the trees whose y does not fit their x, the farthest first."""
    trees = [tree for tree in x if tree in y and x[tree] > 0 and y[tree] > 0]
    line = line_through([x[tree] for tree in trees], [y[tree] for tree in trees])
    if line is None or len(trees) < FEWEST:
        return []
    usual = {tree: line.at(x[tree]) for tree in trees}
    scores = _scores({tree: math.log(y[tree] / usual[tree]) for tree in trees})
    return _named(scores, y, usual)


def line_through(x: Sequence[float], y: Sequence[float]) -> Line | None:
    """Return Theil and Sen's line through the logarithms; None where no two x differ."""
    places = [(math.log(a), math.log(b)) for a, b in zip(x, y, strict=True) if a > 0 and b > 0]
    slopes = [(d - b) / (c - a) for (a, b), (c, d) in combinations(places, 2) if c != a]
    if not slopes:
        return None
    power = median(slopes)
    return Line(math.exp(median(b - power * a for a, b in places)), power)


def _log(ratio: float) -> float:
    return math.log(ratio) if ratio > 0 else -math.inf


def _scores(values: Mapping[str, float]) -> dict[str, float]:
    """Modified z-scores; none where half of the values are equal."""
    if not values:
        return {}
    middle = median(values.values())
    spread = median(abs(value - middle) for value in values.values())
    if spread <= 0 or not math.isfinite(spread):
        return {}
    return {tree: _MAD_SHARE * (value - middle) / spread for tree, value in values.items()}


def _named(
    scores: Mapping[str, float], values: Mapping[str, float], usual: Mapping[str, float]
) -> list[Outlier]:
    apart = [
        Outlier(tree, values[tree], usual[tree], score)
        for tree, score in scores.items()
        if abs(score) > LIMIT
    ]
    return sorted(apart, key=lambda each: -abs(each.score))
