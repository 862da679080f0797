"""Bland-Altman figures: differences of two measurements over their means."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cherrypicker.accuracy.quantities import Quantity
from cherrypicker.report.text import axis_ticks

_WIDTH, _HEIGHT = 300, 190  # of the plot, px, as the template has them
_PAD = 0.08  # of the range of values, left free on either side
_ENDS = ("low", "high")
_LEVELS = ("none", "bias", "lower limit", "upper limit")


def mark(
    first: float, second: float, ends: tuple[float, float] | None, label: str, href: str = ""
) -> dict:
    """A pair of measurements of a figure, in the quantity's own unit.

    Parameters
    ----------
    ends : tuple of float or None
        Of the 90 % interval of the second less the first, which reaches zero where it holds.
    label, href : str
        What it says, and where it leads to.
    """
    low, high = ends or (second - first,) * 2
    numbers = {"x": (first + second) / 2, "y": second - first, "low": low, "high": high}
    return numbers | {"label": label, "href": href}


def bland_altman(
    quantity: Quantity, what: str, marks: Sequence[dict], limits: Mapping[str, float | None]
) -> dict:
    """Return a figure as the numbers of an SVG, which ``bland_altman.html.j2`` draws.

    Parameters
    ----------
    quantity : Quantity
    what : str
        What is less what.
    marks : sequence of dict
        From `mark`, one at least.
    limits : mapping
        ``bias``, and the limits of agreement ``low`` and ``high`` or None.
    """
    unit = quantity.shown_in or quantity.unit
    factor = 1.0 / quantity.units[unit]
    known = [limits[name] for name in ("bias", "low", "high")]
    lines = [0.0, *(factor * level for level in known if level is not None)]
    x_low, x_high = _padded([factor * one["x"] for one in marks])
    y_low, y_high = _padded([*lines, *(factor * one[end] for one in marks for end in _ENDS)])

    def x_of(value: float) -> str:
        return f"{(value - x_low) / (x_high - x_low) * _WIDTH:.1f}"

    def y_of(value: float) -> str:
        return f"{(y_high - value) / (y_high - y_low) * _HEIGHT:.1f}"

    return {
        "title": f"{quantity.title} [{unit}]: {what}",
        "levels": [
            {"y": y_of(level), "name": name, "value": f"{level:+.3g}"}
            for level, name in zip(lines, _LEVELS, strict=False)
        ],
        "x_ticks": [(x_of(tick), f"{tick:g}") for tick in axis_ticks(x_low, x_high)],
        "y_ticks": [(y_of(tick), f"{tick:g}") for tick in axis_ticks(y_low, y_high)],
        "marks": [
            one
            | {"x": x_of(factor * one["x"])}
            | {name: y_of(factor * one[name]) for name in ("y", *_ENDS)}
            for one in marks
        ],
    }


def limits_cells(quantity: Quantity, row: Mapping) -> list[str]:
    """Limits of agreement, and how many intervals hold, for people; dashes where there are none."""
    limits = "–"
    if row["low"] is not None:
        limits = " to ".join(quantity.shown(row[end], sign="+") for end in _ENDS)
    held = f"{row['n_covered']} of {row['n_intervals']}" if row["n_intervals"] else "–"
    return [limits, held]


def _padded(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    pad = _PAD * (high - low) or _PAD * abs(high) or 1.0
    return low - pad, high + pad
