"""Bland-Altman figures: differences of two measurements over their means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cherrypicker.accuracy.quantities import Quantity
from cherrypicker.report.text import axis_ticks

# Of a figure, px: the plot, room for the numbers left of and below it
_LEFT, _TOP, _WIDTH, _HEIGHT, _BELOW, _RIGHT = 62, 24, 300, 190, 40, 14
_PAD = 0.08  # of the range of values, left free on either side
_LEVELS = ("none", "bias", "lower limit", "upper limit")


@dataclass(frozen=True)
class Mark:
    """A pair of measurements, in the quantity's own unit."""

    mean: float
    difference: float
    # Of the 90 % interval of the difference, which reaches zero where it holds; both the difference
    # itself where there is none
    low: float
    high: float
    label: str
    href: str = ""


def bland_altman(
    quantity: Quantity,
    what: str,
    marks: Sequence[Mark],
    levels: tuple[float, float | None, float | None],
) -> dict:
    """Return a figure as the numbers of an SVG, which ``bland_altman.html.j2`` draws.

    Parameters
    ----------
    quantity : Quantity
    what : str
        What is less what.
    marks : sequence of Mark
        One at least.
    levels : tuple of float
        Bias, lower and upper limit of agreement.
    """
    unit = quantity.shown_in or quantity.unit
    factor = 1.0 / quantity.units[unit]
    lines = [0.0, *(factor * level for level in levels if level is not None)]
    x_low, x_high = _padded([factor * mark.mean for mark in marks])
    ends = [factor * end for mark in marks for end in (mark.low, mark.high)]
    y_low, y_high = _padded([*lines, *ends])

    def x_of(value: float) -> str:
        return f"{_LEFT + (value - x_low) / (x_high - x_low) * _WIDTH:.1f}"

    def y_of(value: float) -> str:
        return f"{_TOP + (y_high - value) / (y_high - y_low) * _HEIGHT:.1f}"

    return {
        "title": f"{quantity.title} [{unit}]: {what}",
        "box": (_LEFT, _TOP, _WIDTH, _HEIGHT),
        "view": f"0 0 {_LEFT + _WIDTH + _RIGHT} {_TOP + _HEIGHT + _BELOW}",
        "under": _TOP + _HEIGHT + 16,
        "foot": _TOP + _HEIGHT + 32,
        "right": _LEFT + _WIDTH,
        "levels": [
            {"y": y_of(level), "name": name, "value": f"{level:+.3g}"}
            for level, name in zip(lines, _LEVELS, strict=False)
        ],
        "x_ticks": [(x_of(tick), f"{tick:g}") for tick in axis_ticks(x_low, x_high)],
        "y_ticks": [(y_of(tick), f"{tick:g}") for tick in axis_ticks(y_low, y_high)],
        "marks": [
            {
                "x": x_of(factor * mark.mean),
                "y": y_of(factor * mark.difference),
                "low": y_of(factor * mark.low),
                "high": y_of(factor * mark.high),
                "href": mark.href,
                "label": mark.label,
            }
            for mark in marks
        ],
    }


def _padded(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    pad = _PAD * (high - low) or _PAD * abs(high) or 1.0
    return low - pad, high + pad
