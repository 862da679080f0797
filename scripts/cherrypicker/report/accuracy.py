"""Hand measurements on the pages of a tree and of the batch: a list, agreement, figures."""

from __future__ import annotations

from collections.abc import Sequence

from cherrypicker.accuracy.agreement import PUBLISHED, Agreement, Published, agreement, by_trait
from cherrypicker.accuracy.quantities import QUANTITIES, Quantity
from cherrypicker.report.text import axis_ticks

# Of a figure, px: the plot, room for the numbers left of and below it
_LEFT, _TOP, _WIDTH, _HEIGHT, _BELOW, _RIGHT = 62, 24, 300, 190, 40, 14
_PAD = 0.08  # of the range of values, left free on either side


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
            bland_altman(QUANTITIES[name], pairs, agreements[name])
            for name, pairs in found.items()
            if len(pairs) > 1
        ],
        "list": listed,
    }


def _row(quantity: Quantity, item: Agreement) -> list[str]:
    limits = "–"
    if item.low is not None and item.high is not None:
        limits = f"{quantity.shown(item.low, sign='+')} to {quantity.shown(item.high, sign='+')}"
    return [
        quantity.title,
        str(item.n),
        quantity.shown(item.mae),
        quantity.shown(item.rmse),
        _share(item.relative_rmse),
        _number(item.r2),
        quantity.shown(item.bias, sign="+"),
        limits,
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


def bland_altman(quantity: Quantity, pairs: Sequence[dict], item: Agreement) -> dict:
    """Return a Bland-Altman figure as numbers of an SVG: differences over the means of both.

    A bar is our 90 % interval less the hand measurement; it reaches zero where the interval holds.
    """
    unit = quantity.shown_in or quantity.unit
    factor = 1.0 / quantity.units[unit]
    means = [factor * (pair["ours"] + pair["hand"]) / 2 for pair in pairs]
    bars = [
        [factor * (end - pair["hand"]) for end in (pair["low"], pair["ours"], pair["high"])]
        if pair["low"] is not None and pair["high"] is not None
        else [factor * (pair["ours"] - pair["hand"])] * 3
        for pair in pairs
    ]
    levels = [0.0, factor * item.bias]
    levels += [factor * end for end in (item.low, item.high) if end is not None]
    x_low, x_high = _padded(means)
    y_low, y_high = _padded([*levels, *(end for bar in bars for end in bar)])

    def x_of(value: float) -> str:
        return f"{_LEFT + (value - x_low) / (x_high - x_low) * _WIDTH:.1f}"

    def y_of(value: float) -> str:
        return f"{_TOP + (y_high - value) / (y_high - y_low) * _HEIGHT:.1f}"

    names = ("none", "bias", "lower limit", "upper limit")
    return {
        "title": f"{quantity.title} [{unit}]",
        "box": (_LEFT, _TOP, _WIDTH, _HEIGHT),
        "view": f"0 0 {_LEFT + _WIDTH + _RIGHT} {_TOP + _HEIGHT + _BELOW}",
        "under": _TOP + _HEIGHT + 16,
        "foot": _TOP + _HEIGHT + 32,
        "right": _LEFT + _WIDTH,
        "levels": [
            {"y": y_of(level), "name": name, "value": f"{level:+.3g}"}
            for level, name in zip(levels, names, strict=False)
        ],
        "x_ticks": [(x_of(tick), f"{tick:g}") for tick in axis_ticks(x_low, x_high)],
        "y_ticks": [(y_of(tick), f"{tick:g}") for tick in axis_ticks(y_low, y_high)],
        "marks": [
            {
                "x": x_of(mean),
                "y": y_of(difference),
                "low": y_of(low),
                "high": y_of(high),
                "href": pair["href"],
                "label": f"{pair['tree']}: by hand {pair['given']}, "
                f"ours {quantity.shown(pair['ours'])}",
            }
            for pair, mean, (low, difference, high) in zip(pairs, means, bars, strict=True)
        ],
    }


def _padded(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    pad = _PAD * (high - low) or _PAD * abs(high) or 1.0
    return low - pad, high + pad
