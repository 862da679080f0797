"""The batch page: failures first, then the trees with their numbers, then series over dates.

Within each part the trees stand in the order of ``config/trees.tsv``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import date

from cherrypicker.report.text import page_template, with_uncertainty
from cherrypicker.traits.table import TRAITS, Trait
from cherrypicker.units import unit_name

_SHOWN = [t for t in TRAITS.values() if t.is_shown and t.name != "trunk_height_m"]
_MANY_FLAGS = 6  # of a tree: more make the table hard to read
# Of a chart, px: the plot, the line of dates below it, half a letter's height
_LEFT, _TOP, _PLOT_WIDTH, _PLOT_HEIGHT, _DATES, _HALF_LETTER = 58, 26, 286, 118, 18, 4
_PAD = 0.1  # of its range of values, left free above and below


@dataclass
class TreeResult:
    """What the batch knows of one scan."""

    # tree, date, series: from the table of trees; empty where not given
    tree: str
    date: str = ""
    series: str = ""
    # ``done``, ``failed``, ``interrupted`` (a stage was killed) or ``not run``
    status: str = "not run"
    # Content of ``traits.json``; empty where there is none or where it is out of date
    traits: dict = field(default_factory=dict)
    # stage, cause, file, key, log: of the failure; empty without one
    stage: str = ""
    cause: str = ""
    file: str = ""
    key: str = ""
    log: str = ""
    # report, thumbnail: paths below the results folder; empty where the file is missing
    report: str = ""
    thumbnail: str = ""

    @property
    def unit(self) -> str:
        """``m`` or ``arbitrary``; empty without traits."""
        return str(self.traits.get("unit", "")) if self.traits else ""

    @property
    def flags(self) -> list[str]:
        """Quality warnings of the traits."""
        flags = self.traits.get("flags", [])
        return [str(flag) for flag in flags] if isinstance(flags, list) else [str(flags)]


def summary_html(results: list[TreeResult]) -> str:
    """Return the page over all trees.

    Returns
    -------
    str
        HTML that needs no network; it links to the trees' reports beside it.
    """
    failed = [r for r in results if r.status in ("failed", "interrupted")]
    waiting = [r for r in results if r.status == "not run"]
    done = [r for r in results if r.status == "done"]
    counts = [f"{len(done)} of {len(results)} trees done"]
    counts += [f"{len(failed)} failed"] if failed else []
    counts += [f"{len(waiting)} not run"] if waiting else []
    page = page_template("summary.html.j2").render(
        counts=", ".join(counts),
        failed=failed,
        waiting=waiting,
        titles=[trait.title for trait in _SHOWN],
        done=[(result, [_cell(result, trait) for trait in _SHOWN]) for result in done],
        most_flags=_MANY_FLAGS,
        series=_series(results),
    )
    return page + "\n"


def _cell(result: TreeResult, trait: Trait) -> str:
    value, error = result.traits.get(trait.name), result.traits.get(f"{trait.name}_se")
    return with_uncertainty(value, error, trait, result.unit)


def _series(results: list[TreeResult]) -> list[tuple[str, list[dict]]]:
    """Charts of the series with two dates or more; scans without a scale have no place on them."""
    by_name: dict[str, list] = {}
    for result in results:
        when = _day(result.date)
        if result.series and when is not None and result.unit == "m":
            by_name.setdefault(result.series, []).append((when, result))
    found = []
    for name, scans in sorted(by_name.items()):
        scans.sort(key=lambda scan: (scan[0], scan[1].tree))
        if len({when for when, _ in scans}) < 2:
            continue
        charts = [_chart(scans, trait) for trait in TRAITS.values() if trait.is_charted]
        found.append((name, [chart for chart in charts if chart]))
    return found


def _day(text: str) -> int | None:
    try:
        return date.fromisoformat(text).toordinal()
    except ValueError:
        return None


def _chart(scans: list, trait: Trait) -> dict:
    """One trait over the dates of a series, as numbers of an SVG; empty with fewer than two."""
    name, decimals = trait.name, trait.decimals
    unit, data = unit_name("m", trait.power or 1), []
    for when, result in scans:
        value, error = result.traits.get(name), result.traits.get(f"{name}_se")
        if isinstance(value, int | float):
            label = f"{result.tree}, {result.date}: {value:.{decimals}f} {unit}"
            data.append((when, float(value), float(error or 0.0), label))
    if len({item[0] for item in data}) < 2:
        return {}
    first, last = data[0][0], data[-1][0]
    low = min(value - error for _, value, error, _ in data)
    high = max(value + error for _, value, error, _ in data)
    pad = _PAD * (high - low) or _PAD * abs(high) or 1.0

    def x_of(when: int) -> float:
        return _LEFT + (when - first) / (last - first) * _PLOT_WIDTH

    def y_of(value: float) -> float:
        return _TOP + (high + pad - value) / (high - low + 2 * pad) * _PLOT_HEIGHT

    marks = []
    for when, value, error, label in data:
        x, y, bar = x_of(when), y_of(value), y_of(value - error) - y_of(value)
        path = f"M{x:.1f},{y - bar:.1f}V{y + bar:.1f}" if bar else ""
        marks.append({"x": f"{x:.1f}", "y": f"{y:.1f}", "bar": path, "label": label})
    return {
        "title": f"{trait.title} [{unit}]",
        "left": _LEFT,
        "top": _TOP,
        "width": _PLOT_WIDTH,
        "height": _PLOT_HEIGHT,
        "right": _LEFT + _PLOT_WIDTH,
        "under": _TOP + _PLOT_HEIGHT + _DATES,
        "line": " ".join(f"{mark['x']},{mark['y']}" for mark in marks),
        "marks": marks,
        "ticks": [
            (f"{y_of(value) + _HALF_LETTER:.1f}", f"{value:.{decimals}f}")
            for value in dict.fromkeys((low, high))
        ],
        "first": date.fromordinal(first).isoformat(),
        "last": date.fromordinal(last).isoformat(),
    }
