"""Hand measurements on the pages of a tree and of the batch: a list, agreement, figures."""

from __future__ import annotations

from collections.abc import Sequence

from cherrypicker.accuracy.agreement import PUBLISHED, Agreement, agreement, by_trait
from cherrypicker.accuracy.quantities import QUANTITIES, Quantity
from cherrypicker.report.bland_altman import bland_altman


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
    return {
        "quantities": QUANTITIES,
        "agreements": agreements,
        "published": [item for item in PUBLISHED if item.trait in found],
        "figures": [
            _figure(QUANTITIES[name], pairs, agreements[name])
            for name, pairs in found.items()
            if len(pairs) > 1
        ],
        "pairs": measured,
        "doubtful": [pair for pair in measured if pair["problem"] or pair["doubts"]],
    }


def _figure(quantity: Quantity, pairs: Sequence[dict], item: Agreement) -> dict:
    """Ours less by hand; a bar is our 90 % interval less the hand measurement."""
    marks = []
    for pair in pairs:
        ours, hand = pair["ours"], pair["hand"]
        ends = None if pair["low"] is None else (pair["low"] - hand, pair["high"] - hand)
        label = f"{pair['tree']}: by hand {pair['given']}, ours {quantity.shown(ours)}"
        marks.append((hand, ours, ends, label, pair["href"]))
    return bland_altman(quantity, "ours less by hand", marks, vars(item))
