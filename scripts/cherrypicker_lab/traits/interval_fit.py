"""Factors of the traits' intervals, fitted so that these hold the truth in 90 % of cases.

Quantile regression (Koenker and Bassett 1978) of the logarithm of the error on that of the
interval: of all factors of a trait those are taken whose intervals have the least mean of log width
and, for truths outside, ten times the log of how many times too far off they lie. At the least of
it a tenth lies outside; the unit and the size of a tree do not matter, and one gross error counts
little more than a small one. Every tree weighs the same, however many branches of it were found.
"""

import numpy as np
from scipy.optimize import minimize

from cherrypicker.traits.intervals import KNOWN, Z90

MISSED = 0.1  # share of the truths that may lie outside
DRAWN = ("drawn_low", "drawn_high")
_LOGS = (-7.0, 7.0)  # of a factor over its present value, where it is sought
_STEP = 1.5  # of the first simplex
_TINY = 1e-9


class TraitCases:
    """Cases of one trait as arrays.

    Parameters
    ----------
    cases : list of dict
        From `cherrypicker_lab.traits.cases`, of one trait.
    """

    def __init__(self, cases):
        self.source = np.array([case["source"] for case in cases])
        self.tree = np.array([f"{case['source']} {case['tree']}" for case in cases])
        self.true, self.found, self.low, self.high = (
            np.array([case[key] for case in cases], dtype=float)
            for key in ("true", "found", "low", "high")
        )
        terms = [case["terms"] or {} for case in cases]
        self.is_fitted = np.array([bool(each) for each in terms])
        self.names = sorted({name for each in terms for name in each} - {*KNOWN, *DRAWN})
        self.terms = {
            name: np.array([each.get(name, 0.0) for each in terms])
            for name in (*self.names, *KNOWN, *DRAWN)
        }
        _, tree, count = np.unique(self.tree, return_inverse=True, return_counts=True)
        self.weight = 1.0 / count[tree]

    def select(self, rows):
        """The cases of some rows, (n,) bool."""
        part = object.__new__(TraitCases)
        part.names, part.terms = self.names, {k: v[rows] for k, v in self.terms.items()}
        for name in ("source", "tree", "true", "found", "low", "high", "is_fitted", "weight"):
            setattr(part, name, getattr(self, name)[rows])
        return part

    def interval(self, factors):
        """Lower and upper ends with other factors; as given where the photos gave them."""
        parts = [factors[name] * self.terms[name] for name in self.names]
        half = Z90 * np.sqrt(sum(part**2 for part in [*parts, *(self.terms[k] for k in KNOWN)]))
        low, high = (np.hypot(half, self.terms[name]) for name in DRAWN)
        return (
            np.where(self.is_fitted, np.maximum(self.found - low, 0.0), self.low),
            np.where(self.is_fitted, self.found + high, self.high),
        )

    def loss(self, factors):
        """Mean loss of the cases that factors decide, every tree weighing the same."""
        low, high = self.interval(factors)
        off = self.true - self.found
        arm = np.maximum(np.where(off > 0, high - self.found, self.found - low), _TINY)
        outside = np.log(np.maximum(np.abs(off) / arm, 1.0))
        loss = np.log(np.maximum(high - low, _TINY)) + outside / MISSED
        return float(np.average(loss[self.is_fitted], weights=self.weight[self.is_fitted]))

    def cover(self, factors):
        """Share of the truths that the intervals hold, and their median width."""
        low, high = self.interval(factors)
        return float(np.mean((low <= self.true) & (self.true <= high))), np.median(high - low)


def fit(cases, start):
    """Factors of the least score.

    Parameters
    ----------
    cases : TraitCases
    start : dict of str to float
        Present factors.

    Returns
    -------
    dict of str to float
        By the names of the cases' terms.
    """
    size = np.array([start[name] or 1.0 for name in cases.names])

    def factors_of(logs):
        return dict(zip(cases.names, size * np.exp(np.clip(logs, *_LOGS)), strict=True))

    corners = np.vstack([np.zeros(len(size)), _STEP * np.eye(len(size))])
    runs = [
        minimize(
            lambda logs: cases.loss(factors_of(logs)),
            np.zeros(len(size)),
            method="Nelder-Mead",
            options={"initial_simplex": corners - shift, "xatol": 1e-3, "fatol": 1e-6},
        )
        for shift in (0.0, _STEP)
    ]
    return factors_of(min(runs, key=lambda run: run.fun).x)
