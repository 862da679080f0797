"""The batch's tables and page: every tree with its traits, or with the stage and cause of failure.

No single broken file may keep the other trees from being listed.
"""

import logging
import os
from collections.abc import Collection, Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any

from cherrypicker.batch import tables
from cherrypicker.batch.benchmarks import read_benchmarks
from cherrypicker.batch.resources import ASKED_BY, STAGES
from cherrypicker.batch.trees import folder_name
from cherrypicker.errors import StageError
from cherrypicker.files import read_json, write_json, write_text, written_at
from cherrypicker.report.summary_page import TreeResult, summary_html
from cherrypicker.report.text import thumbnail_url
from cherrypicker.runner import failure_told, status_file, status_folder

logger = logging.getLogger(__name__)

# What not every tree is asked for, and its page is made without, by the rule that makes it
PART_OF = {rule: stage.of for rule, stage in STAGES.items() if stage.of in ASKED_BY}
PART_OF["compare_measures"] = "measures"
# Their failure says nothing against traits.json, which was finished before they started.
_AFTER_TRAITS = frozenset({*PART_OF, "report_tree", "summarise_batch"})


def summarise(trees: list[dict], out_csv: str | os.PathLike, out_html: str | os.PathLike) -> None:
    """Write the tables and the page over all trees of the batch.

    The trees are rows of ``config/trees.tsv``: ``tree`` is needed, ``date`` and ``series`` are
    used. ``parts`` names what there is to read beside the traits, by default hand measurements, of
    `cherrypicker.batch.batch.Batch.parts_of`; ``lacking`` what of it failed or is out of date.

    Beside the table of traits come ``measures.csv`` and ``accuracy.csv``, of hand measurements, and
    ``datapackage.json``, which says what the columns of all three are.
    """
    beside = Path(out_csv).with_name
    results = list(map(result_of, trees))
    failed_series = []  # of those that the table still has
    for name in sorted({result.series for result in results} - {""}):
        record, _ = _read_object(status_file("compare_series", {"series": folder_name(name)}))
        if record:
            failed_series.append(TreeResult(f"series {name}", **_told_by(record)))
    pairs = [{"tree": result.tree, **pair} for result in results for pair in result.measures]
    files = {
        Path(out_csv): (tables.TRAIT_COLUMNS, map(tables.trait_row, results)),
        beside("measures.csv"): (tables.MEASURE_COLUMNS, pairs),
        beside("accuracy.csv"): (tables.ACCURACY_COLUMNS, tables.accuracy_rows(pairs)),
    }
    for path, (columns, rows) in files.items():
        write_text(path, tables.table_csv(columns, rows))
    package = tables.data_package({path.name: columns for path, (columns, _) in files.items()})
    write_json(beside("datapackage.json"), package, indent=1)
    costs = read_benchmarks({result.tree for result in results})
    # In the order in which a tree goes through the stages
    ordered = {rule: costs[rule] for rule in (*STAGES, *costs) if rule in costs}
    write_text(out_html, summary_html(results, ordered, failed_series))


def result_of(row: dict) -> TreeResult:
    """Return what the files of a tree tell; its row is as for :func:`summarise`."""
    tree = str(row["tree"])
    result = TreeResult(tree, str(row.get("date") or ""), str(row.get("series") or ""))
    folder = Path("results", tree)
    if (folder / "report.html").is_file():
        result.report = f"{tree}/report.html"
    series_page = f"series/{folder_name(result.series)}/report.html"
    if result.series and Path("results", series_page).is_file():
        result.series_page = series_page
    result.thumbnail = thumbnail_url(folder / "figures/thumbnail.png")
    traits_path = folder / "traits.json"
    traits, problem = _read_object(traits_path)
    kinds = row.get("parts", ["measures"])
    record = _failure(tree, written_at(traits_path) if traits else 0, kinds)
    if record is None and problem:
        record = {"rule": "measure_traits", "cause": problem, "file": str(traits_path)}
    if record:
        result = replace(result, **_told_by(record))
    elif traits:
        result.status = "done"
    if result.status == "done" or result.stage in _AFTER_TRAITS:
        result.traits = traits
    lacking = row.get("lacking", ())
    for kind in (kind for kind in kinds if result.traits and kind not in lacking):
        result.found[kind], problem = _read_object(folder / f"{kind}.json")
        if problem:
            logger.warning("%s: %s", folder, problem)
    result.measures = result.found.pop("measures", {}).get("measures", [])
    return result


def failures_told(tree: str, lacking: Collection[str]) -> list[str]:
    """Return a line on each part that a tree's page is made without: which, the stage, and why."""
    lines = []
    for rule, part in PART_OF.items():
        if part in lacking:
            record, _ = _read_object(status_file(rule, {"tree": tree}))
            cause = "it was not run: what it needs failed, or the run ended before"
            told = failure_told(_told_by(record or {"cause": cause}))
            lines.append(f"no {part}: {rule}: {told}")
    return lines


def _told_by(record: dict) -> dict[str, Any]:
    """What the record of a job that did not finish tells, as fields of a `TreeResult`."""
    told = {name: str(record.get(name) or "") for name in ("cause", "file", "key", "log")}
    told |= {"status": "failed", "stage": str(record.get("rule") or "")}
    if record.get("state") == "running":
        cause = "the stage was stopped before it finished (killed, or out of memory)"
        told |= {"status": "interrupted", "cause": cause}
    return told


def _failure(tree: str, since: int, kinds: Sequence[str]) -> dict | None:
    """Return the record of the stage that keeps this tree from being done, the earliest failed.

    A record that is older than the tree's traits, or of what is none of the kinds that are asked
    for, belongs to a stage that the tree no longer needs.
    """
    records = []
    for path in sorted(status_folder(tree).glob("*.json")):
        record, problem = _read_object(path)
        if problem:
            record = {"state": "failed", "cause": problem, "file": str(path)}
        rule, written = record.setdefault("rule", path.stem), written_at(path)
        is_after = rule in _AFTER_TRAITS
        if PART_OF.get(rule, "") in {"", *kinds} and (is_after or written >= since):
            records.append(((is_after, record.get("state") == "running", written), record))
    return min(records, key=itemgetter(0))[1] if records else None


def _read_object(path: Path) -> tuple[dict, str]:
    """Return a JSON object and what is wrong with it; ({}, "") where there is no file."""
    if not path.exists():
        return {}, ""
    try:
        content = read_json(path)
    except (OSError, StageError) as error:
        return {}, f"{path.name} is not readable ({getattr(error, 'cause', error)})"
    return content, "" if content else f"{path.name} holds no JSON object"
