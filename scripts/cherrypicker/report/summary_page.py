"""The batch page: failures first, then the trees with their numbers, then series over dates.

Within each part the trees stand in the order of ``config/trees.tsv``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import date
from html import escape
from urllib.parse import quote

from cherrypicker.report.text import STYLE, with_uncertainty
from cherrypicker.traits.table import TRAITS, Trait
from cherrypicker.units import unit_name

__all__ = ["TreeResult", "summary_html"]

_SHOWN = [t for t in TRAITS.values() if t.is_shown and t.name != "trunk_height_m"]
_MANY_FLAGS = 6
_LEFT, _TOP, _PLOT_WIDTH, _PLOT_HEIGHT = 58, 26, 286, 118  # of a chart, px


@dataclass
class TreeResult:
    """What the batch knows of one scan.

    Attributes
    ----------
    tree, date, series : str
        From the table of trees; empty where not given.
    status : str
        ``done``, ``failed``, ``interrupted`` (a stage was killed) or ``not run``.
    traits : dict
        Content of ``traits.json``; empty where there is none or where it is out of date.
    stage, cause, file, key, log : str
        Of the failure; empty without one.
    report, thumbnail : str
        Paths below the results folder; empty where the file is missing.
    """

    tree: str
    date: str = ""
    series: str = ""
    status: str = "not run"
    traits: dict = field(default_factory=dict)
    stage: str = ""
    cause: str = ""
    file: str = ""
    key: str = ""
    log: str = ""
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

    Parameters
    ----------
    results : list of TreeResult

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
    body = [
        "<h1>CherryPicker: batch summary</h1>",
        f'<p class="lead">{", ".join(counts)}. The same as a table: '
        '<a href="traits.csv">traits.csv</a></p>',
    ]
    if failed:
        body.append(_failures(failed))
    if waiting:
        names = ", ".join(escape(r.tree) for r in waiting)
        body.append(f"<h2>Not run</h2><p>{names}</p>")
    if done:
        body.append(_table(done))
    body += _series(results)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>CherryPicker: batch summary</title><style>{STYLE}{_EXTRA}</style></head>\n<body>"
        + "\n".join(body)
        + "\n</body></html>\n"
    )


_EXTRA = """
.thumb img { width: 96px; height: auto; display: block; }
td.name { font-weight: 600; white-space: nowrap; }
td.flagcell { color: var(--warn); font-size: 13px; min-width: 220px; overflow-wrap: anywhere; }
svg text { font: 11px system-ui, sans-serif; fill: #68707c; }
"""


def _failures(failed: list[TreeResult]) -> str:
    rows = []
    for result in failed:
        fix = f"<code>{escape(result.key)}</code>" if result.key else ""
        where = f"<br><code>{escape(result.file)}</code>" if result.file else ""
        log = f"<code>{escape(result.log)}</code>" if result.log else ""
        rows.append(
            f'<tr class="bad"><td class="name">{_link(result)}</td>'
            f'<td class="{escape(result.status)}">{escape(result.status)}</td>'
            f"<td>{escape(result.stage)}</td><td>{escape(result.cause)}{where}</td>"
            f"<td>{fix}</td><td>{log}</td></tr>"
        )
    head = "".join(f"<th>{h}</th>" for h in ("Tree", "Status", "Stage", "Cause", "Change", "Log"))
    return (
        f'<h2>Failed</h2><div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _table(done: list[TreeResult]) -> str:
    names = ["", "Tree", "Date", *(trait.title for trait in _SHOWN), "Warnings"]
    head = "".join(f"<th>{name}</th>" for name in names)
    rows = []
    for result in done:
        cells = [f'<td class="thumb">{_thumbnail(result)}</td>']
        cells.append(f'<td class="name">{_link(result)}</td><td>{escape(result.date)}</td>')
        for trait in _SHOWN:
            value, error = result.traits.get(trait.name), result.traits.get(f"{trait.name}_se")
            text = with_uncertainty(value, error, trait, result.unit)
            cells.append(f'<td class="n">{escape(text)}</td>')
        cells.append(f'<td class="flagcell">{_flags(result)}</td>')
        rows.append(f"<tr>{''.join(cells)}</tr>")
    return (
        f'<h2>Trees</h2><div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _flags(result: TreeResult) -> str:
    lines = [escape(flag) for flag in result.flags[:_MANY_FLAGS]]
    if len(result.flags) > _MANY_FLAGS:
        lines.append(f"and {len(result.flags) - _MANY_FLAGS} more")
    return "<br>".join(lines)


def _link(result: TreeResult) -> str:
    name = escape(result.tree)
    return f'<a href="{escape(quote(result.report))}">{name}</a>' if result.report else name


def _thumbnail(result: TreeResult) -> str:
    if not result.thumbnail:
        return ""
    return f'<img src="{escape(quote(result.thumbnail))}" alt="" loading="lazy">'


def _series(results: list[TreeResult]) -> list[str]:
    """Charts of the series with two dates or more; scans without a scale have no place on them."""
    by_name: dict[str, list] = {}
    for result in results:
        when = _day(result.date)
        if result.series and when is not None and result.unit == "m":
            by_name.setdefault(result.series, []).append((when, result))
    body = []
    for name, scans in sorted(by_name.items()):
        scans.sort(key=lambda scan: (scan[0], scan[1].tree))
        if len({when for when, _ in scans}) < 2:
            continue
        charts = [_chart(scans, trait) for trait in TRAITS.values() if trait.is_charted]
        body.append(f'<h3>{escape(name)}</h3><div class="figures">{"".join(charts)}</div>')
    return ["<h2>Series</h2>", *body] if body else []


def _day(text: str) -> int | None:
    try:
        return date.fromisoformat(text).toordinal()
    except ValueError:
        return None


def _chart(scans: list, trait: Trait) -> str:
    """One trait over the dates of a series as inline SVG, error bars where there are errors."""
    name, decimals = trait.name, trait.decimals
    unit, data = unit_name("m", trait.power or 1), []
    for when, result in scans:
        value, error = result.traits.get(name), result.traits.get(f"{name}_se")
        if isinstance(value, int | float):
            label = f"{result.tree}, {result.date}: {value:.{decimals}f} {unit}"
            data.append((when, float(value), float(error or 0.0), label))
    if len({item[0] for item in data}) < 2:
        return ""
    first, last = data[0][0], data[-1][0]
    low = min(value - error for _, value, error, _ in data)
    high = max(value + error for _, value, error, _ in data)
    pad = 0.1 * (high - low) or 0.1 * abs(high) or 1.0

    def x_of(when: int) -> float:
        return _LEFT + (when - first) / (last - first) * _PLOT_WIDTH

    def y_of(value: float) -> float:
        return _TOP + (high + pad - value) / (high - low + 2 * pad) * _PLOT_HEIGHT

    marks = "".join(
        _mark(x_of(when), y_of(value), y_of(value - error) - y_of(value), label)
        for when, value, error, label in data
    )
    line = " ".join(f"{x_of(when):.1f},{y_of(value):.1f}" for when, value, _, _ in data)
    ticks = "".join(
        f'<text x="{_LEFT - 6}" y="{y_of(value) + 4:.1f}" text-anchor="end">'
        f"{value:.{decimals}f}</text>"
        for value in dict.fromkeys((low, high))
    )
    under, right = _TOP + _PLOT_HEIGHT + 18, _LEFT + _PLOT_WIDTH
    return (
        f'<figure><svg viewBox="0 0 {right + 16} {under + 8}" role="img">'
        f'<text x="{_LEFT}" y="14">{escape(trait.title)} [{unit}]</text>'
        f'<rect x="{_LEFT}" y="{_TOP}" width="{_PLOT_WIDTH}" height="{_PLOT_HEIGHT}" '
        f'fill="#fff" stroke="#d9dde3"/><polyline points="{line}" fill="none" stroke="#22662e"/>'
        f'{marks}{ticks}<text x="{_LEFT}" y="{under}">{date.fromordinal(first).isoformat()}</text>'
        f'<text x="{right}" y="{under}" text-anchor="end">'
        f"{date.fromordinal(last).isoformat()}</text></svg></figure>"
    )


def _mark(x: float, y: float, bar: float, label: str) -> str:
    """A dot with its error bar (half length in px) and its numbers as a tooltip."""
    line = f'<path d="M{x:.1f},{y - bar:.1f}V{y + bar:.1f}" stroke="#22662e"/>' if bar else ""
    return (
        f'{line}<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#22662e">'
        f"<title>{escape(label)}</title></circle>"
    )
