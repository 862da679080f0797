"""Hand measurements on the pages of a tree and of the batch: a list, agreement, figures."""

from __future__ import annotations

from collections.abc import Sequence

from cherrypicker.accuracy.agreement import PUBLISHED, Agreement, Published, agreement, by_trait
from cherrypicker.accuracy.quantities import QUANTITIES, Quantity
from cherrypicker.report.bland_altman import Mark, bland_altman


def accuracy_section(measured: Sequence[tuple[str, str, dict]]) -> dict | None:
    """Return what ``accuracy.html.j2`` shows; None without hand measurements.

    Parameters
    ----------
    measured : sequence of tuple (str, str, dict)
        Tree, link to its page or an empty string, and a pair of its ``measures.json``.
    """
    if not measured:
        return None
    found = by_trait(pair | {"tree": tree, "href": href} for tree, href, pair in measured)
    agreements = {name: agreement(pairs) for name, pairs in found.items()}
    listed = [_listed(tree, href, pair) for tree, href, pair in measured]
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
        _share(item.relative_rmse),
        _number(item.r2),
        quantity.shown(item.bias, sign="+"),
        quantity.shown_limits(item.low, item.high),
        f"{item.n_covered} of {item.n_intervals}" if item.n_intervals else "–",
    ]


def _published(item: Published) -> list[str]:
    quantity = QUANTITIES[item.trait]
    mae = "–" if item.mae is None else quantity.shown(item.mae)
    shares = _share(item.relative_rmse), _number(item.r2)
    return [quantity.title, item.source, item.measured_on, mae, *shares]


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _share(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"


def _listed(tree: str, href: str, pair: dict) -> dict:
    """One hand measurement beside ours, in words."""
    quantity, ours = QUANTITIES[pair["trait"]], pair["ours"]
    row = {"tree": tree, "href": href, "title": quantity.title, "given": pair["given"]}
    row |= {"ours": "–", "interval": "", "difference": "", "is_held": None}
    if ours is not None:
        row |= {"ours": quantity.shown(ours)}
        row |= {"difference": quantity.shown(ours - pair["hand"], sign="+")}
    if pair["low"] is not None and pair["high"] is not None:
        row["interval"] = f"{quantity.shown(pair['low'])} to {quantity.shown(pair['high'])}"
        row["is_held"] = pair["low"] <= pair["hand"] <= pair["high"]
    branch = "" if pair["branch_id"] is None else f"branch {pair['branch_id']}"
    row["where"] = ", ".join(part for part in (pair["place"], branch) if part)
    return row | {name: pair[name] for name in ("who", "note", "problem", "doubts", "line")}


def _figure(quantity: Quantity, pairs: Sequence[dict], item: Agreement) -> dict:
    """Ours less by hand; a bar is our 90 % interval less the hand measurement."""
    marks = []
    for pair in pairs:
        ours, hand = pair["ours"], pair["hand"]
        is_known = pair["low"] is not None and pair["high"] is not None
        ends = (pair["low"] - hand, pair["high"] - hand) if is_known else (ours - hand,) * 2
        label = f"{pair['tree']}: by hand {pair['given']}, ours {quantity.shown(ours)}"
        marks.append(Mark((ours + hand) / 2, ours - hand, *ends, label, pair["href"]))
    return bland_altman(quantity, "ours less by hand", marks, (item.bias, item.low, item.high))
