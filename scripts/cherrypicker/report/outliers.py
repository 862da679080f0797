"""Trees that stand apart from the rest of their batch, by one rule.

A number stands apart where its modified z-score, its distance from the median over the deviation
that the median absolute one tells, is beyond 3.5 (Iglewicz and Hoaglin 1993, How to Detect and
Handle Outliers, ASQC). Sizes of trees are compared by their logarithms: half the median is as far
off as twice the median. Where one size follows another, the number is the distance from the line
through the logarithms of both (Theil 1950 and Sen 1968: the median of the slopes between any two
trees).

Of normal numbers the rule names 1 in 60 among 10 trees, 1 in 150 among 20 and 1 in 1600 among 300
(20,000 draws each); Tukey's fences would name 1 in 25, 1 in 43 and 1 in 125.
"""

import math
from collections.abc import Mapping
from itertools import combinations
from statistics import median
from typing import NamedTuple

from cherrypicker.geometry.robust import MAD_TO_SIGMA

LIMIT = 3.5
FEWEST = 10  # trees; among fewer the rule names more than 1 in 60 that belong to the rest


class Outlier(NamedTuple):
    """One number that stands apart."""

    tree: str
    value: float
    usual: float  # median of all trees, or what the line says of this one
    score: float  # modified z; infinite for a size of zero


def outliers(values: Mapping[str, float]) -> list[Outlier]:
    """Return the trees whose value, a size or a count of each, stands apart, the farthest first."""
    return _apart(values, dict.fromkeys(values, median(values.values()) if values else 0.0))


def off_the_line(
    x: Mapping[str, float], y: Mapping[str, float]
) -> tuple[tuple[float, float] | None, list[Outlier]]:
    """Return the line of y over x, and the trees whose y does not fit it, the farthest first.

    It is Theil and Sen's through the logarithms, y = factor * x ** power; None where no two x
    differ.
    """
    both = {tree: (x[tree], y[tree]) for tree in x if tree in y and x[tree] > 0 and y[tree] > 0}
    logs = [(math.log(a), math.log(b)) for a, b in both.values()]
    slopes = [(d - b) / (c - a) for (a, b), (c, d) in combinations(logs, 2) if c != a]
    if not slopes:
        return None, []
    power = median(slopes)
    factor = math.exp(median(b - power * a for a, b in logs))
    usual = {tree: factor * a**power for tree, (a, _) in both.items()}
    return (factor, power), _apart({tree: y[tree] for tree in both}, usual)


def _apart(values: Mapping[str, float], usual: Mapping[str, float]) -> list[Outlier]:
    """By the modified z-scores of the logarithms; none where half of them are equal."""
    if len(values) < FEWEST or not all(usual.values()):
        return []
    ratios = {tree: value / usual[tree] for tree, value in values.items()}
    logs = {tree: math.log(ratio) if ratio > 0 else -math.inf for tree, ratio in ratios.items()}
    middle = median(logs.values())
    spread = median(abs(value - middle) for value in logs.values())
    if not 0 < spread < math.inf:
        return []
    scores = {tree: (value - middle) / (MAD_TO_SIGMA * spread) for tree, value in logs.items()}
    apart = [
        Outlier(tree, values[tree], usual[tree], score)
        for tree, score in scores.items()
        if abs(score) > LIMIT
    ]
    return sorted(apart, key=lambda each: -abs(each.score))
