"""How right kinds, ages and counts of bearing wood are, against trees whose years are known."""

import numpy as np

from cherrypicker.bearing.ages import age_tree, bare_lengths
from cherrypicker.bearing.measure import (
    KINDS,
    bearing_of_nodes,
    bearing_sums,
    kind_table,
    kinds_and_ages,
)
from cherrypicker.skeleton import axes


def true_kind(tree, n_ages):
    """Kind of each node of an `AgedTree`, a place in `KINDS`, and its age up to the last told."""
    age = np.minimum(tree.age, n_ages)
    return kind_table(n_ages)[tree.is_spur.astype(int), age - 1], age


def true_sums(tree):
    """Shoots, spurs and lengths of an `AgedTree`, as `bearing_sums` names them."""
    axis_list = axes(tree.skeleton)
    kind, _ = true_kind(tree, 6)
    length = bare_lengths(tree.skeleton, axis_list)
    tip = np.setdiff1d(np.arange(len(kind)), tree.skeleton.parent)
    shoot, spur, two = (KINDS.index(name) for name in ("shoot", "spur", "two_year"))
    return {
        "shoots": int((kind[tip] == shoot).sum()),
        "spurs": int((kind[tip] == spur).sum()),
        "shoot_length_m": float(length[kind == shoot].sum()),
        "bearing_length_m": float(length[(kind == spur) | (kind == two)].sum()),
    }


def score_tree(tree, rates, *, truth=None, dated=None):
    """Score the skeleton of an `AgedTree`, whose nodes' true ages are known.

    Sums are compared with those of ``truth``, the whole tree where `tree` is what was seen of it;
    ``dated``, (n_nodes, n_ages), is as of `age_tree`. Returns ``sums`` and ``true`` by name,
    ``length`` and ``tips``, (4, 4) of true kind by told kind (m and numbers), and ``age_right_m``
    of ``length_m``.
    """
    axis_list = axes(tree.skeleton)
    ages = age_tree(tree.skeleton, axis_list, rates, dated)
    kind, age = kinds_and_ages(ages.chance)
    wanted, true_age = true_kind(tree, rates.n_ages)
    length = np.zeros((len(KINDS), len(KINDS)))
    np.add.at(length, (wanted, kind), ages.length)
    tips = np.zeros(len(kind), dtype=bool)
    tips[[axis.nodes[-1] for axis in axis_list]] = True
    counts = np.zeros_like(length)
    np.add.at(counts, (wanted[tips], kind[tips]), 1)
    return {
        "name": tree.name,
        "sums": bearing_sums(bearing_of_nodes(axis_list, ages), np.full(len(kind), True), None),
        "true": true_sums(truth or tree),
        "length": length.tolist(),
        "tips": counts.tolist(),
        "age_right_m": float(ages.length[age == true_age].sum()),
        "length_m": float(ages.length.sum()),
    }


def f1_by_kind(table):
    """F1 of each kind by a table of true by told kinds, (4,) float64."""
    table = np.asarray(table)
    return 2 * np.diag(table) / np.maximum(table.sum(axis=0) + table.sum(axis=1), 1e-12)


def summarise(scores):
    """Figures of trees together: F1 by length, ages, R2 and errors of sums."""
    found = f1_by_kind(sum(np.array(s["length"]) for s in scores))
    tips = f1_by_kind(sum(np.array(s["tips"]) for s in scores))
    lines = {"trees": len(scores)}
    lines["f1"] = dict(zip(KINDS, found.round(3).tolist(), strict=True))
    lines["f1_of_tips"] = dict(zip(KINDS[:2], tips[:2].round(3).tolist(), strict=True))
    lines["age_right"] = round(
        sum(s["age_right_m"] for s in scores) / sum(s["length_m"] for s in scores), 3
    )
    for name in ("shoots", "spurs", "shoot_length_m", "bearing_length_m"):
        told = np.array([s["sums"][name] for s in scores])
        true = np.array([s["true"][name] for s in scores], dtype=float)
        spread = ((true - true.mean()) ** 2).sum()
        lines[name] = {
            # Of one tree, or of trees that are alike, there is none
            "r2": round(1 - ((told - true) ** 2).sum() / spread, 3) if spread else None,
            "mae_share": round(float(np.abs(told - true).sum() / true.sum()), 3),
            "bias_share": round(float((told - true).sum() / true.sum()), 3),
        }
    return lines
