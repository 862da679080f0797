"""The batch page: failures, a table of all trees, outliers, charts, hand measurements, costs.

The table, the outliers and what follows are in the page as written; the charts are drawn in it from
the same numbers by ``summary.js``, so that they follow the table's filter.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from statistics import median
from typing import Any, NamedTuple
from urllib.parse import quote

from cherrypicker.files import is_number
from cherrypicker.progress import duration
from cherrypicker.pruning.target import LIMIT_WORDS
from cherrypicker.report.accuracy import accuracy_section
from cherrypicker.report.outliers import FEWEST, LIMIT, off_the_line, outliers
from cherrypicker.report.text import page_template, script_json
from cherrypicker.traits.table import TRAITS, Trait
from cherrypicker.units import unit_word

_SHOWN = [t for t in TRAITS.values() if t.is_shown and t.name != "trunk_height_m"]
# One size over another: wood and crown follow the stem (the allometry of a planting)
_PAIRS = (("tcsa_cm2", "total_length_m"), ("tcsa_cm2", "crown_volume_m3"))
_STATUSES = ("failed", "interrupted", "not run", "done")  # as the table has them
# What a batch is sorted by to decide what to do: a column of the table, and whether the most comes
# first, by the words for an order
_ORDERS = {
    "most over a target": ("over_target", True),
    "most cuts": ("n_cuts", True),
    "most shoots": ("shoots", True),
    "darkest": ("sky_share", False),
    "least sure by the photos": ("photo_precision", False),
}


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
    # Hand measurements beside ours: the pairs of ``measures.json``
    measures: list[dict] = field(default_factory=list)
    # What else was asked for, ``pruning``, ``bearing`` or ``light``: content of its JSON
    found: dict[str, dict] = field(default_factory=dict)
    # stage, cause, file, key, log: of the failure; empty without one
    stage: str = ""
    cause: str = ""
    file: str = ""
    key: str = ""
    log: str = ""
    # report, series_page: paths below the results folder; empty where the file is missing
    report: str = ""
    series_page: str = ""
    thumbnail: str = ""  # picture as a data URL; empty where there is none

    @property
    def unit(self) -> str:
        """``m`` or ``arbitrary``; empty without traits."""
        return str(self.traits.get("unit", "")) if self.traits else ""

    @property
    def flags(self) -> list[str]:
        """Quality warnings of the traits."""
        flags = self.traits.get("flags", [])
        return [str(flag) for flag in flags] if isinstance(flags, list) else [str(flags)]

    @property
    def href(self) -> str:
        """Link to the tree's page; empty where there is none."""
        return quote(self.report)

    def number(self, trait: Trait) -> float | None:
        """Return a trait that can stand beside other trees'; None without a scale."""
        value = self.traits.get(trait.name)
        return value if is_number(value) and (self.unit == "m" or not trait.power) else None


class Decision(NamedTuple):
    """A column of the batch's table: its name, its title, and of a tree the number and its text."""

    name: str
    title: str
    number: float
    text: str


def decisions_of(found: Mapping[str, Mapping]) -> list[Decision]:
    """What is to be decided of a tree, by its ``pruning.json``, ``bearing.json``, ``light.json``.

    None of what no file tells, or tells in another form: no single file may keep the other trees
    from being listed.
    """
    told: list[Decision] = []
    with suppress(LookupError, TypeError, ValueError):
        number = found["pruning"]["n_cuts"]
        told.append(Decision("n_cuts", "Cuts", float(number), f"{number:d}"))
    with suppress(LookupError, TypeError, ValueError):
        # Of what is to be gone altogether the cuts tell; of none there is no maximum
        limits = [each for each in found["pruning"]["targets"] if each["limit"] > 0]
        most = max(limits, key=lambda each: each["before"] / each["limit"])
        share, words = most["before"] / most["limit"], LIMIT_WORDS[most["name"]]
        text = f"{words}: {most['before']:.2f}, at most {most['limit']:g}" if share > 1 else "none"
        told.append(Decision("over_target", "Most over a target", share, text))
    for name, title, file, form in (
        ("shoots", "One-year shoots", "bearing", "{:.0f}"),
        ("sky_share", "Share of the sky's light", "light", "{:.0%}"),
    ):
        with suppress(LookupError, TypeError, ValueError):
            number = float(found[file][name])
            told.append(Decision(name, title, number, form.format(number).replace("%", " %")))
    return told


def summary_html(
    results: Sequence[TreeResult],
    costs: Mapping[str, Mapping[str, Any]],
    failed_series: Sequence[TreeResult],
) -> str:
    """Return the page over all trees: HTML that links to the trees' pages beside it alone.

    ``costs`` are what jobs took, by stage and tree: each has ``wall_s``, ``cpu_s`` and
    ``memory_mb``. ``failed_series``, comparisons of two dates that failed, stand with the failed
    trees.
    """
    ordered = sorted(results, key=lambda result: _STATUSES.index(result.status))
    count = {status: sum(r.status == status for r in results) for status in _STATUSES}
    counts = [f"{count['done']} of {len(results)} trees done"]
    counts += [f"{count[status]} {status}" for status in _STATUSES[:3] if count[status]]
    sizes = {
        trait.name: {r.tree: value for r in results if (value := r.number(trait)) is not None}
        for trait in _SHOWN
        # Shares have their own warnings
        if trait.power is not None or trait.is_count
    }
    apart = {name: outliers(values) for name, values in sizes.items()}
    lines = {(x, y): off_the_line(sizes[x], sizes[y]) for x, y in _PAIRS}
    decided = {result.tree: {d.name: d for d in decisions_of(result.found)} for result in ordered}
    decisions = {d.name: d.title for some in decided.values() for d in some.values()}
    known = {t.name for t in _SHOWN if any(r.number(t) is not None for r in results)}
    known |= decisions.keys()
    measured = [{**pair, "tree": r.tree, "href": r.href} for r in results for pair in r.measures]
    named = [(TRAITS[name], "", each) for name, some in apart.items() for each in some]
    named += [
        (TRAITS[y], f" for its {TRAITS[x].title.lower()}", each)
        for (x, y), (_, some) in lines.items()
        for each in some
    ]
    page = page_template("summary.html.j2").render(
        counts=", ".join(counts),
        failed=[*(r for r in ordered if r.status in ("failed", "interrupted")), *failed_series],
        decisions=decisions,
        traits=_SHOWN,
        rows=[(result, decided[result.tree]) for result in ordered],
        orders={words: order for words, order in _ORDERS.items() if order[0] in known},
        outliers=sorted(named, key=lambda one: -abs(one[2].score)),
        result_of={result.tree: result for result in results},
        fewest=FEWEST,
        limit=LIMIT,
        accuracy=accuracy_section(measured),
        costs=costs,
        duration=duration,
        median=median,
        data=script_json(_data(ordered, apart, lines, costs)),
    )
    return page + "\n"


def _data(
    results: Sequence[TreeResult], apart: Mapping, lines: Mapping, costs: Mapping[str, Mapping]
) -> dict:
    """What the charts are drawn from; trees are named by their place among the results."""
    place = {result.tree: index for index, result in enumerate(results)}
    return {
        "traits": [
            {
                "name": trait.name,
                "title": trait.title,
                "unit": unit_word(trait.name),
                "apart": [place[each.tree] for each in apart.get(trait.name, ())],
            }
            for trait in _SHOWN
        ],
        "trees": [
            {
                "tree": result.tree,
                "href": result.href,
                "date": result.date,
                "series": result.series,
                "values": [result.number(trait) for trait in _SHOWN],
                "errors": [_number(result.traits.get(f"{trait.name}_se")) for trait in _SHOWN],
            }
            for result in results
        ],
        "pairs": [
            {"x": x, "y": y, "line": line, "apart": [place[each.tree] for each in some]}
            for (x, y), (line, some) in lines.items()
        ],
        "stages": [
            {
                "rule": rule,
                "jobs": [
                    [place[tree], _number(job.wall_s), _number(job.memory_mb / 1000)]
                    for tree, job in jobs.items()
                ],
            }
            for rule, jobs in costs.items()
        ],
    }


def _number(value: object) -> float | None:
    return value if is_number(value) else None
