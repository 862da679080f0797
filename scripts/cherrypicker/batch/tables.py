"""The batch's tables for other programs, and the dictionary that says what their columns are.

``traits.csv``, ``accuracy.csv`` and ``measures.csv`` are described in ``datapackage.json`` as a
Tabular Data Package (https://specs.frictionlessdata.io/tabular-data-package/).
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import cherrypicker
from cherrypicker.accuracy.agreement import PUBLISHED, agreement, by_trait
from cherrypicker.accuracy.quantities import QUANTITIES
from cherrypicker.report.summary_page import TreeResult
from cherrypicker.traits.table import TRAITS, Trait

_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    name: str
    kind: str  # Table Schema's: string, number, integer, date
    title: str
    definition: str = ""
    unit: str = ""  # as the tables spell it; empty for text, and where the row has its own

    def field(self) -> dict:
        """Return the column as Table Schema describes it, with its unit."""
        about = {"name": self.name, "type": self.kind, "title": self.title}
        about |= {"unit": self.unit} if self.unit else {}
        return about | ({"description": self.definition} if self.definition else {})


def _value(trait: Trait) -> Column:
    kind = "integer" if trait.is_count else "number"
    return Column(trait.name, kind, trait.title, trait.definition, trait.unit)


def _error(trait: Trait) -> Column:
    title = f"{trait.title}, standard error"
    return Column(f"{trait.name}_se", "number", title, unit=trait.unit)


def _interval(trait: Trait) -> list[Column]:
    title = f"{trait.title}, {{}} end of the 90 % interval"
    return [
        Column(f"{trait.name}_ci90_{end}", "number", title.format(word), unit=trait.unit)
        for end, word in (("low", "lower"), ("high", "upper"))
    ]


_SURE = [trait for trait in TRAITS.values() if trait.has_error]
_ARBITRARY = (
    "m, or arbitrary for a scan without a scale: then all lengths, areas and volumes of the row "
    "are in a unit of its own, whatever their columns are called"
)
_SINCE = ("n_limbs", "limb_trunk_ratio")  # shown, and in no version up to 0.1.0
_FIRST = [trait for trait in TRAITS.values() if trait.is_shown and trait.name not in _SINCE]
_LAST = [trait for trait in TRAITS.values() if trait not in _FIRST]
#: Of ``traits.csv``. Programs may count on the order: a new column comes last.
TRAIT_COLUMNS = [
    Column("tree", "string", "Tree", "id in the table of trees"),
    Column("status", "string", "Status", "done, failed, interrupted, not run"),
    Column("failed_stage", "string", "Failed stage", "keeps the tree from being done"),
    Column("cause", "string", "Cause", "why that stage failed"),
    Column("change", "string", "To change", "config key or column of a table"),
    Column("date", "date", "Date", "of the scan"),
    Column("series", "string", "Series", "shared by the scans of one tree"),
    Column("unit", "string", "Unit of length", _ARBITRARY),
    *(_value(trait) for trait in _FIRST),
    *(_error(trait) for trait in _SURE if trait.has_error_column),
    Column("flags", "string", "Warnings", "joined by '; '"),
    *(_value(trait) for trait in _LAST),
    *(_error(trait) for trait in _SURE if not trait.has_error_column),
    *(column for trait in _SURE for column in _interval(trait)),
]
_ROWS_UNIT = "in the row's unit"
#: Of ``measures.csv``.
MEASURE_COLUMNS = [
    Column("tree", "string", "Tree"),
    Column("trait", "string", "Trait"),
    Column("unit", "string", "Unit", "of hand, ours, low and high"),
    Column("hand", "number", "By hand", _ROWS_UNIT),
    Column("ours", "number", "Ours", _ROWS_UNIT),
    Column("low", "number", "Lower end of our 90 % interval", _ROWS_UNIT),
    Column("high", "number", "Upper end of our 90 % interval", _ROWS_UNIT),
    Column("given", "string", "As given", "number and unit of the hand measurement"),
    Column("who", "string", "Who measured"),
    Column("place", "string", "Place", "on the tree, as given"),
    Column("branch_id", "integer", "Branch", "in branches.csv", "1"),
    Column("problem", "string", "Problem", "why there is no number of ours"),
    Column("doubts", "string", "Doubts", "joined by '; '"),
    Column("note", "string", "Note"),
]
_R2 = (
    "1 - squared errors / squares of the hand measurements about their mean; a paper's by its own "
    "definition"
)
#: Of ``accuracy.csv``: first this batch, a row a trait, then what others have published.
ACCURACY_COLUMNS = [
    Column("trait", "string", "Trait"),
    Column("unit", "string", "Unit", "of mae, rmse, bias and the limits"),
    Column("source", "string", "Source", "this batch, or a paper"),
    Column("measured_on", "string", "Measured on", "the trees of a paper"),
    Column("n", "integer", "Pairs", unit="1"),
    Column("mae", "number", "Mean absolute error", _ROWS_UNIT),
    Column("rmse", "number", "Root mean square error", _ROWS_UNIT),
    Column("relative_rmse", "number", "RMSE over the mean by hand", unit="1"),
    Column("r2", "number", "R2", _R2, "1"),
    Column("bias", "number", "Bias", "mean of ours less by hand, in the row's unit"),
    Column("low", "number", "Lower limit of agreement", "bias - 1.96 standard deviations"),
    Column("high", "number", "Upper limit of agreement", "bias + 1.96 standard deviations"),
    Column("n_intervals", "integer", "Pairs with a 90 % interval", unit="1"),
    Column("n_covered", "integer", "Intervals that hold the hand measurement", unit="1"),
]


def trait_row(result: TreeResult) -> dict:
    """Return a tree's row of ``traits.csv``."""
    row = {name: getattr(result, name) for name in ("tree", "status", "date", "series", "unit")}
    row |= {"failed_stage": result.stage, "cause": result.cause, "change": result.key}
    for trait in _SURE:
        ends = result.traits.get(f"{trait.name}_ci90") or (None, None)
        row |= {f"{trait.name}_ci90_low": ends[0], f"{trait.name}_ci90_high": ends[1]}
    return result.traits | row | {"flags": "; ".join(result.flags)}


def accuracy_rows(pairs: Sequence[dict]) -> list[dict]:
    """Return how well each measured trait agrees, then the published rows of these traits."""
    found = by_trait(pairs)
    rows = [
        {"trait": name, "source": "this batch", "measured_on": ""} | asdict(agreement(of_trait))
        for name, of_trait in found.items()
    ]
    rows += [
        {"trait": item.trait, "source": item.source, "measured_on": item.measured_on}
        | dict.fromkeys(("n", "rmse", "bias", "low", "high", "n_intervals", "n_covered"))
        | {"mae": item.mae, "relative_rmse": item.relative_rmse, "r2": item.r2}
        for item in PUBLISHED
        if item.trait in found
    ]
    return [row | {"unit": QUANTITIES[row["trait"]].unit} for row in rows]


def csv_text(columns: Sequence[Column], rows: Iterable[Mapping]) -> str:
    """Return a table as CSV with a header."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([column.name for column in columns])
    writer.writerows([_cell(column, row) for column in columns] for row in rows)
    return stream.getvalue()


def _cell(column: Column, row: Mapping) -> str:
    value = row.get(column.name)
    if column.kind in ("integer", "number"):
        if isinstance(value, bool) or not isinstance(value, int | float):
            return ""
        return str(value) if isinstance(value, int) else f"{value:.6g}"
    text = "; ".join(value) if isinstance(value, list) else str(value)
    return text if column.name == "tree" else _inert(text)


def _inert(text: str) -> str:
    """Return a text that no spreadsheet takes for a formula."""
    return f"'{text}" if text.startswith(_FORMULA_STARTS) else text


def data_package(tables: Mapping[str, Sequence[Column]]) -> str:
    """Return ``datapackage.json``.

    Parameters
    ----------
    tables : mapping of str to sequence of Column
        Columns by the name of the CSV file beside it.
    """
    package = {
        "profile": "tabular-data-package",
        "name": "cherrypicker-batch",
        "title": "Traits of the trees of a batch, measured by CherryPicker",
        "version": cherrypicker.__version__,
        "resources": [_resource(name, columns) for name, columns in tables.items()],
    }
    return json.dumps(package, indent=1, ensure_ascii=False) + "\n"


def _resource(name: str, columns: Sequence[Column]) -> dict:
    schema: dict[str, Any] = {"fields": [column.field() for column in columns]}
    if columns is TRAIT_COLUMNS:
        schema["primaryKey"] = "tree"
    return {
        "name": name.removesuffix(".csv"),
        "path": name,
        "profile": "tabular-data-resource",
        "format": "csv",
        "mediatype": "text/csv",
        "encoding": "utf-8",
        "schema": schema,
    }
