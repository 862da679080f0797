"""Hand measurements on the pages of a tree and of the batch: a list, agreement, figures."""

from __future__ import annotations

from collections.abc import Sequence

from cherrypicker.accuracy.agreement import PUBLISHED, Agreement, Published, agreement, by_trait
from cherrypicker.accuracy.quantities import QUANTITIES, Quantity
from cherrypicker.report.bland_altman import bland_altman, limits_cells, mark


def accuracy_section(measured: Sequence[dict]) -> dict | None:
    """Return what ``accuracy.html.j2`` shows; None without hand measurements.

    Parameters
    ----------
    measured : sequence of dict
        Pairs of ``measures.json``, with ``tree`` and ``href``, the link to its page; both are empty
        on the page of a tree.
    """
    if not measured:
        return None
    found = by_trait(measured)
    agreements = {name: agreement(pairs) for name, pairs in found.items()}
    listed = [_listed(pair) for pair in measured]
    return {
        "doubtful": [row for row in listed if row["problem"] or row["doubts"]],
        "rows": [_row(QUANTITIES[name], item) for name, item in agreements.items()],
        "published": [_published(item) for item in PUBLISHED if item.trait in found],
        "figures": [
            _figure(QUANTITIES[name], pairs, agreements[name])
            for name, pairs in found.items()
            if len(pairs) > 1
        ],
        "list": listed,
    }


def _row(quantity: Quantity, item: Agreement) -> list[str]:
    return [
        quantity.title,
        str(item.n),
        quantity.shown(item.mae),
        quantity.shown(item.rmse),
        *_explained(item),
        quantity.shown(item.bias, sign="+"),
        *limits_cells(quantity, vars(item)),
    ]


def _published(item: Published) -> list[str]:
    quantity = QUANTITIES[item.trait]
    mae = "–" if item.mae is None else quantity.shown(item.mae)
    return [quantity.title, item.source, item.measured_on, mae, *_explained(item)]


def _explained(item: Agreement | Published) -> list[str]:
    """RMSE as a share of the mean, and R²."""
    share = "–" if item.relative_rmse is None else f"{100 * item.relative_rmse:.1f} %"
    return [share, "–" if item.r2 is None else f"{item.r2:.2f}"]


def _listed(pair: dict) -> dict:
    """One hand measurement beside ours, in words."""
    quantity, ours = QUANTITIES[pair["trait"]], pair["ours"]
    row = pair | {"title": quantity.title, "ours": "–", "interval": "", "difference": ""}
    row["is_held"] = None
    if ours is not None:
        row["ours"] = quantity.shown(ours)
        row["difference"] = quantity.shown(ours - pair["hand"], sign="+")
    if pair["low"] is not None:
        row["interval"] = f"{quantity.shown(pair['low'])} to {quantity.shown(pair['high'])}"
        row["is_held"] = pair["low"] <= pair["hand"] <= pair["high"]
    branch = "" if pair["branch_id"] is None else f"branch {pair['branch_id']}"
    return row | {"where": ", ".join(part for part in (pair["place"], branch) if part)}


def _figure(quantity: Quantity, pairs: Sequence[dict], item: Agreement) -> dict:
    """Ours less by hand; a bar is our 90 % interval less the hand measurement."""
    marks = []
    for pair in pairs:
        ours, hand = pair["ours"], pair["hand"]
        ends = None if pair["low"] is None else (pair["low"] - hand, pair["high"] - hand)
        label = f"{pair['tree']}: by hand {pair['given']}, ours {quantity.shown(ours)}"
        marks.append(mark(hand, ours, ends, label, pair["href"]))
    return bland_altman(quantity, "ours less by hand", marks, vars(item))
