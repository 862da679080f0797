"""Factors of the traits' intervals, fitted so that these hold the truth in 90 % of cases.

Quantile regression (Koenker and Bassett 1978) of the logarithm of the error on that of the
interval: of all factors of a trait those are taken whose intervals have the least mean of log width
and, for truths outside, ten times the log of how many times too far off they lie. At the least of
it a tenth lies outside; the unit and the size of a tree do not matter, and one gross error counts
little more than a small one. Every source weighs the same, and every tree of it, however many
branches of it were found.
"""

import numpy as np
from scipy.optimize import minimize

from cherrypicker.geometry.error_terms import KNOWN
from cherrypicker.traits.intervals import Z90
from cherrypicker_lab.tables import markdown_table
from cherrypicker_lab.traits.tables import JUDGED

MISSED = 0.1  # share of the truths that may lie outside
DRAWN = ("drawn_low", "drawn_high")
_LOGS = (-7.0, 7.0)  # of a factor over its present value, where it is sought
_STEP = 1.5  # of the first simplex
_TINY = 1e-9


class TraitCases:
    """Cases of `tree_cases`, of one trait, as arrays."""

    def __init__(self, cases):
        self.cases = cases
        self.source = np.array([case["source"] for case in cases])
        self.tree = np.array([f"{case['source']} {case['tree']}" for case in cases])
        self.true, self.found, self.low, self.high = (
            np.array([case[key] for case in cases], dtype=float)
            for key in ("true", "found", "low", "high")
        )
        terms = [case["terms"] or {} for case in cases]
        self.is_least = np.array([case["at_least"] for case in cases], dtype=bool)
        self.has_terms = np.array([bool(each) for each in terms])
        self.is_fitted = self.has_terms & ~self.is_least
        self.names = sorted({name for each in terms for name in each} - {*KNOWN, *DRAWN})
        self.terms = {
            name: np.array([each.get(name, 0.0) for each in terms])
            for name in (*self.names, *KNOWN, *DRAWN)
        }
        trees, tree, n_cases = np.unique(self.tree, return_inverse=True, return_counts=True)
        _, of_tree, n_trees = np.unique(
            [each.split(" ")[0] for each in trees], return_inverse=True, return_counts=True
        )
        self.weight = 1.0 / (n_cases * n_trees[of_tree])[tree]

    def select(self, rows):
        """The cases of some rows, (n,) bool."""
        return TraitCases([case for case, is_in in zip(self.cases, rows, strict=True) if is_in])

    def interval(self, factors):
        """Lower and upper ends with other factors; as given where the photos gave them.

        A value that is the least has no upper end.
        """
        parts = [factors[name] * self.terms[name] for name in self.names]
        half = Z90 * np.sqrt(sum(part**2 for part in [*parts, *(self.terms[k] for k in KNOWN)]))
        low, high = (np.hypot(half, self.terms[name]) for name in DRAWN)
        return (
            np.where(self.has_terms, np.maximum(self.found - low, 0.0), self.low),
            np.where(self.is_least, np.inf, np.where(self.has_terms, self.found + high, self.high)),
        )

    def loss(self, factors):
        """Mean loss of the cases that factors decide, every source weighing the same."""
        low, high = self.interval(factors)
        off = self.true - self.found
        arm = np.maximum(np.where(off > 0, high - self.found, self.found - low), _TINY)
        outside = np.log(np.maximum(np.abs(off) / arm, 1.0))
        loss = np.log(np.maximum(high - low, _TINY)) + outside / MISSED
        return float(np.average(loss[self.is_fitted], weights=self.weight[self.is_fitted]))

    def cover(self, factors):
        """Share of the truths that the intervals hold, and their median width where it ends."""
        low, high = self.interval(factors)
        width = (high - low)[~self.is_least]
        held = float(np.mean((low <= self.true) & (self.true <= high)))
        return held, float(np.median(width)) if len(width) else np.inf


def fit(cases, start):
    """Factors of the least loss by the names of the cases' terms, from the present ones."""
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


def fit_all(cases, present, checked=()):
    """Fit the factors of every trait to the cases of all trees.

    `present` is the content of ``interval_factors.yaml``; sources that are `checked` are not fitted
    to, only measured. Returns the same content with new values, and what each was fitted on, and a
    Markdown table of the cover by trait and source: as measured, with the new factors, and with
    those that are fitted without that source.
    """
    values = {name: entry["value"] for name, entry in present.items()}
    new, parts = dict(present), []
    for trait in dict.fromkeys(case["trait"] for case in cases):
        own = TraitCases([case for case in cases if case["trait"] == trait])
        used = own.select(~np.isin(own.source, checked))
        factors = fit(used, values)
        for name in own.names:
            told = {"value": float(f"{factors[name]:.3g}"), "fitted_on": _told(used)}
            new[name] = present[name] | told
        parts.append((trait, own, used, factors))
    rows = []
    for trait, own, used, factors in parts:
        for source in np.unique(own.source):
            rest = used.select(used.source != source)
            other = factors if source in checked or not len(rest.true) else fit(rest, values)
            rows.append(_row(trait, source, own.select(own.source == source), factors, other))
    header = ["trait", "source", "trees", "n", "bias", "MAE", "before", "with these factors",
              "median width", "without its source"]  # fmt: skip
    return new, markdown_table(header, rows, 2)


def _row(trait, source, cases, factors, other):
    """Line of the table; the interval before is the one that was measured."""
    judged = JUDGED[trait]
    before = np.mean((cases.low <= cases.true) & ((cases.true <= cases.high) | cases.is_least))
    cover, width = cases.cover(factors)
    off = judged.factor * (cases.found - cases.true)
    cells = [f"{judged.words}, {judged.unit}", source, str(len(np.unique(cases.tree)))]
    cells += [str(len(off)), f"{off.mean():+.2f}", f"{np.abs(off).mean():.2f}"]
    cells += [f"{100 * before:.0f} %", f"{100 * cover:.0f} %", f"{judged.factor * width:.1f}"]
    return [*cells, f"{100 * cases.cover(other)[0]:.0f} %"]


def _told(cases):
    """What a factor was fitted on, in words."""
    names, n = np.unique([tree.split(" ")[0] for tree in np.unique(cases.tree)], return_counts=True)
    trees = ", ".join(f"{count} {name}" for name, count in zip(names, n, strict=True))
    return f"{np.count_nonzero(cases.is_fitted)} values of {n.sum()} trees: {trees}"
