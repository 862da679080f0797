"""The batch's table and page: every tree with its traits, or with the stage and cause of failure.

Called by Snakemake's ``onsuccess`` and ``onerror`` handlers inside the main process, so nothing
heavy is imported here and no single broken file may keep the other trees from being listed.
"""

from __future__ import annotations

import csv
import io
import json
import os
from datetime import datetime
from pathlib import Path

from cherrypicker.files import write_text
from cherrypicker.report.summary_page import TreeResult, summary_html
from cherrypicker.traits.table import TRAITS

_TRAIT_COLUMNS = (
    *(trait.name for trait in TRAITS.values() if trait.is_shown),
    *(f"{trait.name}_se" for trait in TRAITS.values() if trait.has_error_column),
)
_ABOUT = ("tree", "status", "failed_stage", "cause", "change", "date", "series", "unit")
_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
# Their failure says nothing against traits.json, which was finished before they started.
_AFTER_TRAITS = frozenset({"report_tree", "summarise_batch"})


def summarise(
    trees: list[dict],
    results_dir: str | os.PathLike,
    logs_dir: str | os.PathLike,
    out_csv: str | os.PathLike,
    out_html: str | os.PathLike,
) -> None:
    """Write the table and the page over all trees of the batch.

    Files are only touched when their content changes, so that writing them after every run does
    not make anything out of date.

    Parameters
    ----------
    trees : list of dict
        Rows of ``config/trees.tsv``; ``tree`` is needed, ``date`` and ``series`` are used.
    results_dir, logs_dir : path-like
        ``results`` and ``logs`` of the run.
    out_csv, out_html : path-like
        Table and page to write.
    """
    results = collect_results(trees, results_dir, logs_dir)
    _write_if_changed(out_csv, summary_csv(results))
    _write_if_changed(out_html, summary_html(results))


def collect_results(
    trees: list[dict], results_dir: str | os.PathLike, logs_dir: str | os.PathLike
) -> list[TreeResult]:
    """Return one :class:`TreeResult` a row of the table, in the table's order."""
    results_dir, logs_dir = Path(results_dir), Path(logs_dir)
    return [_result_of(row, results_dir, logs_dir) for row in trees]


def summary_csv(results: list[TreeResult]) -> str:
    """Return the batch's table as CSV with a header, one row a tree in the table's order."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*_ABOUT, *_TRAIT_COLUMNS, "flags"])
    for result in results:
        numbers = [_number(result.traits.get(name)) for name in _TRAIT_COLUMNS]
        row = [result.tree, result.status, result.stage, _inert(result.cause), _inert(result.key)]
        row += [result.date, _inert(result.series), result.unit, *numbers]
        row += [_inert("; ".join(result.flags))]
        writer.writerow(row)
    return stream.getvalue()


def _inert(text: str) -> str:
    """Return a text that no spreadsheet takes for a formula."""
    return f"'{text}" if text.startswith(_FORMULA_STARTS) else text


def _result_of(row: dict, results_dir: Path, logs_dir: Path) -> TreeResult:
    tree = str(row["tree"])
    result = TreeResult(tree, str(row.get("date") or ""), str(row.get("series") or ""))
    folder = results_dir / tree
    for name, path in (("report", "report.html"), ("thumbnail", "figures/thumbnail.png")):
        if (folder / path).is_file():
            setattr(result, name, f"{tree}/{path}")
    traits_path = folder / "traits.json"
    traits, problem = _read_object(traits_path)
    record = _failure(logs_dir / "status" / tree, traits_path if traits else None)
    if record is None and problem:
        record = {"rule": "measure_traits", "cause": problem, "file": str(traits_path)}
    if record is None:
        if traits:
            result.status, result.traits = "done", traits
        return result
    result.status = "interrupted" if record.get("state") == "running" else "failed"
    result.stage = str(record.get("rule") or "")
    result.cause = str(record.get("cause") or "")
    if result.status == "interrupted":
        result.cause = "the stage was stopped before it finished (killed, or out of memory)"
    for name in ("file", "key", "log"):
        setattr(result, name, str(record.get(name) or ""))
    if result.stage in _AFTER_TRAITS and traits:
        result.traits = traits
    return result


def _failure(status_dir: Path, traits_path: Path | None) -> dict | None:
    """Return the record of the stage that keeps this tree from being done, the earliest failed.

    A record that is older than the tree's traits belongs to a stage that the tree no longer needs.
    """
    records = []
    for path in sorted(status_dir.glob("*.json")) if status_dir.is_dir() else []:
        record, problem = _read_object(path)
        if problem:
            record = {"rule": path.stem, "state": "failed", "cause": problem, "file": str(path)}
        record.setdefault("rule", path.stem)
        is_later = traits_path is None or path.stat().st_mtime >= traits_path.stat().st_mtime
        if is_later or record["rule"] in _AFTER_TRAITS:
            records.append((record.get("state") == "running", _time(record, path), record))
    return min(records, key=lambda item: item[:2])[2] if records else None


def _time(record: dict, path: Path) -> float:
    try:
        return datetime.strptime(str(record.get("time")), "%Y-%m-%dT%H:%M:%S%z").timestamp()
    except ValueError:
        return path.stat().st_mtime


def _read_object(path: Path) -> tuple[dict, str]:
    """Return a JSON object and what is wrong with it; ({}, "") where there is no file."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}, ""
    except (OSError, ValueError) as error:
        return {}, f"{path.name} is not readable ({' '.join(str(error).split())})"
    if not isinstance(content, dict) or not content:
        return {}, f"{path.name} holds no JSON object"
    return content, ""


def _number(value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return ""
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def _write_if_changed(path: str | os.PathLike, text: str) -> None:
    path = Path(path)
    try:
        is_same = path.read_text(encoding="utf-8") == text
    except (OSError, UnicodeDecodeError):
        is_same = False
    if not is_same:
        write_text(path, text)
