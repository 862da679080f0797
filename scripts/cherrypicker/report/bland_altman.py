"""Bland-Altman figures: differences of two measurements over their means."""

from collections.abc import Mapping, Sequence

from cherrypicker.accuracy.quantities import Quantity

_WIDTH, _HEIGHT = 300, 190  # of the plot, px, as the template has them
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
    x_ticks = _round_numbers(means)
    y_ticks = _round_numbers([*lines, *(at for bar in bars for at in bar[1:])])
    (x_low, *_, x_high), (y_low, *_, y_high) = x_ticks, y_ticks

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
        "x_ticks": [(x_of(at), f"{at:g}") for at in x_ticks],
        "y_ticks": [(y_of(at), f"{at:g}") for at in y_ticks],
        "marks": [
            (x_of(mean), *map(y_of, bar), *told)
            for mean, bar, (_, _, _, *told) in zip(means, bars, pairs, strict=True)
        ],
    }


def _round_numbers(values: Sequence[float]) -> list[float]:
    """Some that hold all values between the first and the last."""
    from matplotlib.ticker import MaxNLocator  # every run of Snakemake imports this module

    locator = MaxNLocator(6, steps=[1, 2, 5, 10])
    return list(locator.tick_values(*locator.nonsingular(min(values), max(values))))
