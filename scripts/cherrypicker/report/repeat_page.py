"""The page of repeated scans: how far two scans of a tree differ, and what a trial needs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields

from cherrypicker.accuracy.quantities import QUANTITIES
from cherrypicker.accuracy.repeatability import Pair, Repeatability, repeatability, trees_to_show
from cherrypicker.report.bland_altman import bland_altman
from cherrypicker.report.text import page_template

COLUMNS = ("trait", "unit", *(field.name for field in fields(Repeatability)), "n_trees")


def repeat_rows(pairs: Mapping[str, Sequence[Pair]], difference: float) -> list[dict]:
    """Rows of ``repeat.csv``, a quantity each, by `COLUMNS`.

    Pairs are as of `cherrypicker.accuracy.rescans.pairs_of`, of one tree or of several. The
    ``difference`` is what a trial shall show between two groups, a share of the mean.
    """
    found = []
    for name, both in pairs.items():
        quantity, item, n_trees = QUANTITIES[name], repeatability(both), None
        within, between = item.within_cv, item.between_cv
        # Else the spread of the trees is not known
        if not quantity.is_on_branch and within is not None and between is not None:
            n_trees = trees_to_show(difference, math.hypot(within, between))
        found.append({"trait": name, "unit": quantity.unit, **asdict(item), "n_trees": n_trees})
    return found


def repeat_page(
    scans: Sequence[tuple[str, str]],
    pairs: Mapping[str, Sequence[Pair]],
    rows: Sequence[dict],
    difference: float,
) -> str:
    """Render the page, HTML that needs no network; all text from data is escaped.

    The ``scans`` are the two of each tree, the ``rows`` what `repeat_rows` made of the pairs and
    the difference.
    """
    told, figures = [(QUANTITIES[row["trait"]], row) for row in rows], []
    for quantity, row in told:
        marks: list[tuple] = []
        for pair in pairs[quantity.name]:
            away, half = pair.second - pair.first, pair.half or 0.0
            label = f"{pair.what}: {quantity.shown(pair.first)}, then {quantity.shown(pair.second)}"
            marks.append((pair.first, pair.second, (away - half, away + half), label, ""))
        if len(marks) > 1:
            figures.append(bland_altman(quantity, "second less first scan", marks, row))
    page = page_template("repeat.html.j2").render(
        scans=scans, difference=f"{100 * difference:g} %", rows=told, figures=figures
    )
    return page + "\n"
