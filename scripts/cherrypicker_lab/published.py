"""Figures that pages show, in one committed file from which the pages' tables are rendered.

``docs/figures.json`` holds what a run measured, a section a table, with the command that measured
it; its section ``tables`` holds tables as a benchmark's script wrote them. A table stands in its
page, with date and command below it, between ``<!-- figures: SECTION NAME -->`` and
``<!-- end of figures -->``; nobody writes there by hand, and a test compares both.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import read_json, rounded
from cherrypicker_lab import error_budget
from cherrypicker_lab.evaluation import evaluate
from cherrypicker_lab.skeletons.graph_scores import THICK_M
from cherrypicker_lab.skeletons.tables import gather
from cherrypicker_lab.tables import markdown_rows, markdown_table

FIGURES = "docs/figures.json"
_BLOCK = re.compile(
    r"(?P<head><!-- figures: (?P<section>\w+)(?P<tree>( \w+)?) -->\n)"
    r".*?(?P<end><!-- end of figures -->)",
    re.DOTALL,
)


def pages(project: Path) -> list[Path]:
    """Pages with rendered tables, sorted: README.md and those below ``docs``."""
    found = [project / "README.md", *sorted(project.glob("docs/**/*.md"))]
    return [page for page in found if _BLOCK.search(page.read_text(encoding="utf-8"))]


def measure_demo(results: Path, tree: str, truth: Path) -> dict[str, Any]:
    """What a finished demo tree is published with.

    The batch's ``results`` have ``benchmarks`` beside them; the truth is that of the tree's scene.
    Returns the numbers of `cherrypicker_lab.evaluation.evaluate`, the photos' verdict of
    ``traits.json`` and ``cpu_s``, the CPU time of all stages, seconds. Raises a `StageError` if the
    tree is not finished.
    """
    found = evaluate(results / tree, truth)
    if "n_registered" not in found:
        raise StageError("no poses: the demo is from photos", file=results / tree)
    traits = read_json(results / tree / "traits.json")
    found |= {name: traits[name] for name in ("photo_precision", "photo_recall")}
    found["cpu_s"] = _cpu_seconds(results.parent / "benchmarks", tree)
    return _rounded(found)


def _cpu_seconds(benchmarks: Path, tree: str) -> float:
    """CPU seconds of all stages of a tree; Snakemake's column ``cpu_time``."""
    files = sorted(benchmarks.glob(f"*/{tree}.tsv"))
    if not files:
        raise StageError(f"no benchmark of {tree} to take the CPU time from", file=benchmarks)
    total = 0.0
    for file in files:
        with open(file, newline="", encoding="utf-8") as stream:
            total += float(next(csv.DictReader(stream, delimiter="\t"))["cpu_time"])
    return total


def measure_budget(folder: Path, tree: str) -> dict[str, Any]:
    """The error budget of a tree, with the names of its rungs and stages as they were measured."""
    budget = read_json(folder / tree / "budget.json")
    kept = {name: budget[name] for name in ("ladder", "costs", "dearest")}
    return _rounded(kept) | {"names": error_budget.NAMES, "stages": error_budget.STAGES}


#: Programs of the table of peers in its order, with their version, and the graph that counts.
_PROGRAMS: dict[str, tuple[str, str]] = {
    "peer_lbc": ("pc-skeletor {}, LBC", "own"),
    "peer_slbc": ("pc-skeletor {}, S-LBC", "own"),
    "peer_pytlidar": ("PyTLidar {}", "own"),
    "bare_default": ("ours, all wood called branch", "tree"),
    "slbc_default": ("ours", "tree"),
}


def measure_peers(folder: Path) -> dict[str, Any]:
    """What each program costs and finds on the paper's set with noise, without holes.

    The folder is ``results/benchmark/skeleton`` after ``snakemake benchmark_peers``. Returns
    ``versions`` by program, and ``trees``: by tree that every program has finished, and program
    ``cpu_s``, ``peak_mb``, ``junction_f1``, ``tip_f1``, ``diameter_error_m`` by `THICK_M` of the
    radius (empty where a program gives none), ``length_error`` (relative, signed) and
    ``ways_within_10pct``. Raises a `StageError` if a program was not run, or there is no tree that
    all have finished.
    """
    table = gather(sorted(folder.glob("*/scores_*.json")))
    missing = [name for name in _PROGRAMS if ("noise", name) not in table]
    if missing:
        raise StageError(f"not measured: {', '.join(missing)}", file=folder)
    runs = {name: table["noise", name] for name in _PROGRAMS}
    common = sorted(set.intersection(*(set(found) for found in runs.values())))
    if not common:
        raise StageError("there is no tree that every program has finished", file=folder)
    trees = {
        tree: {name: _of_run(found[tree], _PROGRAMS[name][1]) for name, found in runs.items()}
        for tree in common
    }
    reports = {name: found[common[0]] for name, found in runs.items()}
    versions = {name: report["version"] for name, report in reports.items() if "version" in report}
    return _rounded({"versions": versions, "trees": trees})


def _of_run(report: Mapping[str, Any], name: str) -> dict[str, Any]:
    """What is published of one program on one tree, by its graph of this name."""
    graph = report["graphs"][name]
    return {
        "cpu_s": report["cpu_s"] + graph["cpu_s"],
        "peak_mb": report["peak_mb"],
        "junction_f1": graph["junctions"]["f1"],
        "tip_f1": graph["tips"]["f1"],
        "diameter_error_m": {size: 2 * error for size, error in graph.get("radius", {}).items()},
        "length_error": graph["length_error"],
        "ways_within_10pct": graph["ways_within_10pct"],
    }


def peers_table(section: Mapping[str, Any]) -> str:
    """Return the table of peers as Markdown: means over the trees, and which those are."""
    trees = section["trees"]
    lines = []
    for name, (program, _) in _PROGRAMS.items():
        found = [tree[name] for tree in trees.values()]
        mean = {
            key: float(np.mean([abs(each[key]) for each in found]))
            for key in found[0]
            if key != "diameter_error_m"
        }
        errors = [each["diameter_error_m"] for each in found]
        diameters = [
            f"{1000 * np.mean([error[size] for error in errors]):+.1f}"
            if all(size in error for error in errors)
            else ""
            for size in THICK_M
        ]
        lines.append(
            [
                program.format(section["versions"].get(name)),
                f"{mean['cpu_s']:.1f}",
                f"{mean['peak_mb']:.0f}",
                f"{mean['junction_f1']:.2f}",
                f"{mean['tip_f1']:.2f}",
                *diameters,
                f"{100 * mean['length_error']:.1f} %",
                f"{100 * mean['ways_within_10pct']:.0f} %",
            ]
        )
    header = ["program", "CPU s", "MB", "junction F1", "tip F1",
              "diameter off by, mm: below 8 mm", "8 to 24 mm", "thicker",
              "length off by", "ways within 10 %"]  # fmt: skip
    return f"{markdown_table(header, lines)}\nMeans over {', '.join(trees)}.\n"


def read_table(text: str) -> dict[str, Any]:
    """Take the first table of a Markdown text, as the benchmarks' scripts write them.

    Returns ``columns``, how each is ``aligned`` (Markdown's rule), and ``rows`` of cells, all str.
    Raises a `StageError` if there is none, or a row has another number of cells.
    """
    found = re.search(r"(?m)^\|.*\n\|[-:| ]+\|\n(?:\|.*(?:\n|$))*", text)
    if found is None:
        raise StageError("no table in this text: a head, a rule and rows between bars")
    cells = [
        [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip()[1:-1])]
        for line in found[0].strip().splitlines()
    ]
    if len({len(row) for row in cells}) != 1:
        raise StageError("a row of the table has another number of cells than its head")
    return {"columns": cells[0], "aligned": cells[1], "rows": cells[2:]}


def _rounded(value: Any) -> Any:
    """Six decimals everywhere: what a table can show, and a file that people can read."""
    if isinstance(value, Mapping):
        return {name: _rounded(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return rounded(value) if isinstance(value, float) else value


#: Rows of the demo's table: title, bar, and how a tree's numbers are shown.
_DEMO: tuple[tuple[str, str, Callable[[Mapping], str]], ...] = (
    ("photos registered", "95 %", lambda f: f"{f['n_registered']} of {f['n_photos']}"),
    ("scale error", "0.5 %", lambda f: f"{100 * f['scale_error']:.2f} %"),
    ("up direction", "1 degree", lambda f: f"{f['up_error_deg']:.2f} degrees"),
    (
        "skeleton recall at 2 cm, wood of 5 mm radius and more",
        "0.80",
        lambda f: f"{f['skeleton_recall']:.2f}",
    ),
    (
        "skeleton precision at 2 cm, same wood",
        "0.80",
        lambda f: f"{f['skeleton_precision']:.2f}",
    ),
    (
        "trunk diameter error",
        "6 mm",
        lambda f: f"{1000 * f['trunk_diameter_error_m']:.1f} mm",
    ),
    ("height error", "3 %", lambda f: f"{100 * f['height_error']:.1f} %"),
    (
        "skeleton recall, all wood down to 2 mm radius",
        "",
        lambda f: f"{f['skeleton_recall_all']:.2f}",
    ),
    (
        "F1 of tips within 3 cm",
        "0.80",
        lambda f: f"{f['tips_f1']:.2f}",
    ),
    (
        "tips / total length over the true",
        "- / 3 %",
        lambda f: f"{f['n_tips_ratio']:.2f} / {f['total_length_m_ratio']:.2f}",
    ),
    (
        "what the photos say: precision / recall of the skeleton before the sky",
        "",
        lambda f: f"{f['photo_precision']:.2f} / {f['photo_recall']:.2f}",
    ),
    (
        "F1 of wood / trunk / branch points",
        "0.99 / 0.95 / 0.98",
        lambda f: f"{f['wood_f1']:.3f} / {f['trunk_f1']:.3f} / {f['branch_f1']:.3f}",
    ),
    ("CPU time, all stages", "", lambda f: f"{f['cpu_s']:.0f} s"),
)


def demo_table(trees: Mapping[str, Mapping]) -> str:
    """Return README's table of the demo as Markdown."""
    lines = [f"| | {' | '.join(trees)} | asked |", f"|---|{'---|' * len(trees)}---|"]
    for title, bar, shown in _DEMO:
        cells = " | ".join(shown(figures) for figures in trees.values())
        lines.append(f"| {title} | {cells} | {bar} |" if bar else f"| {title} | {cells} | |")
    return "\n".join(lines) + "\n"


def render(page: str, figures: Mapping[str, Any]) -> str:
    """Return a page with its tables as the figures say; nothing else of it changes.

    Raises a `StageError` if the page asks for a section or a tree that is not there.
    """

    def table(match: re.Match) -> str:
        section, tree = match["section"], match["tree"].strip()
        try:
            measured = figures[section]
            trees = measured.get("trees", {})
            if section == "tables":
                measured = measured[tree]
                text = markdown_rows([measured["columns"], measured["aligned"], *measured["rows"]])
            elif section == "peers":
                text = peers_table(figures[section])
            elif section == "demo":
                text = demo_table(trees)
            else:
                text = error_budget.markdown({tree: trees[tree]})
        except KeyError as error:
            raise StageError(f"no figures of {error}", file=FIGURES) from error
        by = f" by {measured['command']}" if measured["command"] else ""
        said = f"Measured {measured['date']}{by}."
        return f"{match['head']}\n{text.rstrip()}\n\n{said}\n\n{match['end']}"

    return _BLOCK.sub(table, page)
