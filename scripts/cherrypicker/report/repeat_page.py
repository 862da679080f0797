"""The page of repeated scans: how far two scans of a tree differ, and what a trial needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields

from cherrypicker.accuracy.quantities import QUANTITIES, Quantity
from cherrypicker.accuracy.repeatability import Pair, Repeatability, repeatability, trees_to_show
from cherrypicker.report.bland_altman import bland_altman
from cherrypicker.report.text import page_template

COLUMNS = ("trait", "unit", *(field.name for field in fields(Repeatability)), "n_trees")


def repeat_rows(pairs: Mapping[str, Sequence[Pair]], difference: float) -> list[dict]:
    """Rows of ``repeat.csv``, a quantity each, by `COLUMNS`.

    Parameters
    ----------
    pairs : mapping of str to sequence of Pair
        As of `cherrypicker.accuracy.rescans.pairs_of`, of one tree or of several.
    difference : float
        That a trial shall show between two groups, a share of the mean.
    """
    found = []
    for name, both in pairs.items():
        quantity, item = QUANTITIES[name], repeatability(both)
        about = {"trait": name, "unit": quantity.unit}
        found.append(about | asdict(item) | {"n_trees": _n_trees(quantity, item, difference)})
    return found


def _n_trees(quantity: Quantity, item: Repeatability, difference: float) -> int | None:
    """Trees of a group; None for branches, and where the spread of the trees is not known."""
    if quantity.is_on_branch or item.within_cv is None or item.between_cv is None:
        return None
    return trees_to_show(difference, (item.within_cv**2 + item.between_cv**2) ** 0.5)


def repeat_page(
    scans: Sequence[tuple[str, str]],
    pairs: Mapping[str, Sequence[Pair]],
    rows: Sequence[dict],
    difference: float,
) -> str:
    """Render the page.

    Parameters
    ----------
    scans : sequence of tuple (str, str)
        The two scans of each tree.
    pairs, difference
        As of `repeat_rows`.
    rows : sequence of dict
        What it made of them.

    Returns
    -------
    str
        HTML that needs no network; all text from data is escaped.
    """
    page = page_template("repeat.html.j2").render(
        scans=scans,
        difference=f"{100 * difference:g} %",
        rows=[(QUANTITIES[row["trait"]], row) for row in rows],
        figures=[
            _figure(QUANTITIES[row["trait"]], pairs[row["trait"]], row)
            for row in rows
            if row["n_pairs"] > 1
        ],
    )
    return page + "\n"


def _figure(quantity: Quantity, pairs: Sequence[Pair], row: dict) -> dict:
    marks = []
    for pair in pairs:
        difference, half = pair.second - pair.first, pair.half or 0.0
        ends = difference - half, difference + half
        label = f"{pair.what}: {quantity.shown(pair.first)}, then {quantity.shown(pair.second)}"
        marks.append((pair.first, pair.second, ends, label, ""))
    return bland_altman(quantity, "second less first scan", marks, row)
