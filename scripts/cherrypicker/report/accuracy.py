"""Hand measurements on the pages of a tree and of the batch: a list, agreement, figures."""

from collections.abc import Sequence

from cherrypicker.accuracy.agreement import PUBLISHED, agreement, by_trait
from cherrypicker.accuracy.quantities import QUANTITIES
from cherrypicker.report.bland_altman import bland_altman


def accuracy_section(measured: Sequence[dict]) -> dict | None:
    """Return what ``accuracy.html.j2`` shows; None without hand measurements.

    These are pairs of ``measures.json``, with ``tree`` and ``href``, the link to its page; both are
    empty on the page of a tree.
    """
    if not measured:
        return None
    found, figures = by_trait(measured), []
    agreements = {name: agreement(pairs) for name, pairs in found.items()}
    for name, pairs in found.items():
        quantity, marks = QUANTITIES[name], []
        for pair in pairs:
            ours, hand = pair["ours"], pair["hand"]
            ends = None if pair["low"] is None else (pair["low"] - hand, pair["high"] - hand)
            label = f"{pair['tree']}: by hand {pair['given']}, ours {quantity.shown(ours)}"
            marks.append((hand, ours, ends, label, pair["href"]))
        if len(marks) > 1:
            item = vars(agreements[name])
            figures.append(bland_altman(quantity, "ours less by hand", marks, item))
    return {
        "quantities": QUANTITIES,
        "agreements": agreements,
        "published": [item for item in PUBLISHED if item.trait in found],
        "figures": figures,
        "pairs": measured,
        "doubtful": [pair for pair in measured if pair["problem"] or pair["doubts"]],
    }
