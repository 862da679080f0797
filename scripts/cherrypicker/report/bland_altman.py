"""Bland-Altman figures: differences of two measurements over their means."""

from collections.abc import Mapping, Sequence

from cherrypicker.accuracy.quantities import Quantity

_WIDTH, _HEIGHT = 300, 190  # of the plot, px, as the template has them
_PAD = 0.08  # of the range of values, left free on either side
_LEVELS = ("none", "bias", "lower limit", "upper limit")


def bland_altman(
    quantity: Quantity, what: str, pairs: Sequence[tuple], limits: Mapping[str, float | None]
) -> dict:
    """Return a figure as the numbers of an SVG, which ``bland_altman.html.j2`` draws.

    The title says ``what`` is less what. Of each pair, one at least, there are both measurements in
    the quantity's own unit; the ends of the 90 % interval of the second less the first, or None,
    which reaches zero where it holds; what the mark says, and where it leads. The ``limits`` are
    ``bias``, and the limits of agreement ``low`` and ``high`` or None.
    """
    unit = quantity.shown_in or quantity.unit
    factor = 1.0 / quantity.units[unit]
    known = [limits[name] for name in ("bias", "low", "high")]
    lines = [0.0, *(factor * level for level in known if level is not None)]
    means = [factor * ((first + second) / 2) for first, second, *_ in pairs]
    bars = [  # difference, and the ends of its interval
        tuple(factor * at for at in (b - a, *(ends or (b - a, b - a)))) for a, b, ends, *_ in pairs
    ]
    x_low, x_high = _padded(means)
    y_low, y_high = _padded([*lines, *(at for bar in bars for at in bar[1:])])

    def x_of(value: float) -> str:
        return f"{(value - x_low) / (x_high - x_low) * _WIDTH:.1f}"

    def y_of(value: float) -> str:
        return f"{(y_high - value) / (y_high - y_low) * _HEIGHT:.1f}"

    from matplotlib.ticker import MaxNLocator  # every run of Snakemake imports this module

    round_numbers = MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values
    return {
        "title": f"{quantity.title} [{unit}]: {what}",
        "levels": [
            {"y": y_of(level), "name": name, "value": f"{level:+.3g}"}
            for level, name in zip(lines, _LEVELS, strict=False)
        ],
        "x_ticks": [
            (x_of(at), f"{at:g}") for at in round_numbers(x_low, x_high) if x_low <= at <= x_high
        ],
        "y_ticks": [
            (y_of(at), f"{at:g}") for at in round_numbers(y_low, y_high) if y_low <= at <= y_high
        ],
        "marks": [
            (x_of(mean), *map(y_of, bar), *told)
            for mean, bar, (_, _, _, *told) in zip(means, bars, pairs, strict=True)
        ],
    }


def _padded(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    pad = _PAD * (high - low) or _PAD * abs(high) or 1.0
    return low - pad, high + pad
