"""The table of hand measurements, ``config/measures.csv``: one row a measurement.

Read by Snakemake's main process at every start, so nothing heavy is imported.
"""

import csv
import difflib
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cherrypicker.accuracy.quantities import NAMES, QUANTITIES, Quantity, known_unit
from cherrypicker.errors import StageError
from cherrypicker.files import csv_text, read_user_table, write_text

CONFIG_KEY = "measures"
_NEEDED = ("tree", "trait", "value", "unit")
_POINT = ("x_m", "y_m", "z_m")
_PLACE = ("height_m", "azimuth_deg", "distance_m", *_POINT, "order")
_SEPARATORS = ",;\t"
COLUMNS = (*_NEEDED, "who", *_PLACE, "date", "note")


@dataclass(frozen=True)
class Measure:
    """One row of the table."""

    tree: str
    quantity: Quantity
    number: float  # as it stands in the table
    unit: str  # there, as `cherrypicker.accuracy.quantities.UNITS` spells it
    who: str
    note: str
    # height_m, azimuth_deg, distance_m, x_m, y_m, z_m, order: those that are given
    place: Mapping[str, float]
    line: int  # of the file

    @property
    def value(self) -> float:
        """The measured value in the quantity's own unit."""
        return self.number * self.quantity.units[self.unit]

    @property
    def given(self) -> str:
        """Number and unit, for people."""
        return f"{self.number:g}" if self.unit == "1" else f"{self.number:g} {self.unit}"

    @property
    def order(self) -> int | None:
        """Order of the branch that it was taken on, where that was noted."""
        return int(self.place["order"]) if "order" in self.place else None

    @property
    def point(self) -> tuple[float, float, float] | None:
        """The place as a point of ``segmented.ply``; None where it is told otherwise."""
        if not set(_POINT) <= self.place.keys():
            return None
        x, y, z = (self.place[name] for name in _POINT)
        return x, y, z


def read_measures(path: str | os.PathLike, *, may_miss: bool = False) -> list[Measure]:
    """Read and check the table of hand measurements; a file that is not there may count as empty.

    Columns are separated by commas, semicolons or tabs; with the latter two a decimal comma is
    allowed. A byte order mark, blank lines and lines that start with ``#`` are allowed.

    Raises
    ------
    StageError
        For an unknown or missing column, trait or unit, a value that is no number or makes sense
        in another unit only, or a place that is not whole; the message names the line.
    """
    if may_miss and not Path(path).exists():
        return []
    title = "the table of hand measurements"
    rows, separator = read_user_table(
        path, title, COLUMNS, _NEEDED, separators=_SEPARATORS, key=CONFIG_KEY
    )
    found = []
    for number, row in rows:
        try:
            found.append(_measure(row, number, has_comma=separator != ","))
        except _RowError as error:
            cause = f"line {number}, tree {row['tree']!r}: {error}"
            raise StageError(cause, file=path, key=error.column) from None
    return found


def measures_csv(
    rows: Sequence[Measure], columns: Sequence[str] = COLUMNS, separator: str = ","
) -> str:
    """Return measurements as text of the table, with its head."""
    told = (
        {"tree": row.tree, "trait": row.quantity.short_name, "value": row.number}
        | {"unit": "" if row.unit == "1" else row.unit, "who": row.who, "note": row.note}
        | dict(row.place)
        for row in rows
    )
    cells = ({name: row.get(name) for name in columns} for row in told)
    return csv_text(cells, columns, separator)


def append_measures(path: str | os.PathLike, rows: Sequence[Measure]) -> None:
    """Add rows to the table of hand measurements, which need not be there.

    A `StageError` where the table cannot be read, lacks a column that the rows need, or has one of
    the rows: the same value and note, wherever it stands on the tree.
    """
    known = {_content(row): row.line for row in read_measures(path, may_miss=True)}
    again = [known[_content(row)] for row in rows if _content(row) in known]
    if again:
        cause = f"{len(again)} of {len(rows)} rows are there already, the first in line {again[0]}"
        raise StageError(f"{cause}; take them out first", file=path, key=CONFIG_KEY)
    text = Path(path).read_bytes().decode("utf-8") if Path(path).exists() else ""
    lines = text.removeprefix("\ufeff").splitlines()
    heads = [line for line in lines if line.strip(f" {_SEPARATORS}") and line[0] != "#"]
    head = heads[0] if heads else ",".join(COLUMNS)
    separator = max(_SEPARATORS, key=head.count)
    columns = [name.strip() for name in next(csv.reader([head], delimiter=separator))]
    missing = [name for name in (*_POINT, "order", "height_m", "note") if name not in columns]
    missing += ["who"] if any(row.who for row in rows) and "who" not in columns else []
    if missing:
        cause = f"the table has no column {', '.join(missing)}; add it to the head"
        raise StageError(cause, file=path, key=CONFIG_KEY)
    body = measures_csv(rows, columns, separator)
    if heads:
        body = ("" if text.endswith("\n") else "\n") + body.partition("\n")[2]
    write_text(path, text + body)


def _content(row: Measure) -> tuple:
    return row.tree, row.quantity.name, row.number, row.unit, row.who, row.note


class _RowError(Exception):
    """What is wrong with a row, and in which column."""

    def __init__(self, column: str, reason: str) -> None:
        super().__init__(reason)
        self.column = column


def _measure(row: dict[str, str], line: int, *, has_comma: bool) -> Measure:
    if not row["tree"]:
        raise _RowError("tree", "no tree is named")
    if row["trait"] not in NAMES:
        near = difflib.get_close_matches(row["trait"], QUANTITIES, n=1, cutoff=0.0)[0]
        raise _RowError("trait", f"unknown trait {row['trait']!r}; did you mean {near!r}?")
    quantity = NAMES[row["trait"]]
    number, unit = _number(row, "value", has_comma), known_unit(row["unit"])
    if unit not in quantity.units:
        known = ", ".join(quantity.units)
        reason = f"{row['unit']!r} is no unit of {quantity.name}; it may be in {known}"
        raise _RowError("unit", reason)
    place = {name: _number(row, name, has_comma) for name in _PLACE if row[name]}
    if place.get("order", 0) % 1 or place.get("order", 0) < 0:
        raise _RowError("order", "an order is 0 for the trunk, 1 for its branches, and so on")
    given = [name for name in _POINT if name in place]
    if given and len(given) < len(_POINT):
        raise _RowError(given[0], "a point needs x_m, y_m and z_m")
    by_direction = "height_m" in place and "azimuth_deg" in place
    if quantity.is_on_branch and not given and not by_direction:
        reason = f"{quantity.name} needs its place: x_m, y_m and z_m, or height_m and azimuth_deg"
        raise _RowError("height_m", reason)
    measure = Measure(row["tree"], quantity, number, unit, row["who"], row["note"], place, line)
    if not quantity.low <= measure.value <= quantity.high:
        units, low, high = quantity.units.items(), quantity.low, quantity.high
        better = " or ".join(unit for unit, factor in units if low <= factor * number <= high)
        hint = f"; was it measured in {better}?" if better else ""
        reason = f"{measure.given} makes no sense as {quantity.title.lower()}{hint}"
        raise _RowError("unit" if better else "value", reason)
    return measure


def _number(row: dict[str, str], column: str, has_comma: bool) -> float:
    text = row[column].replace(",", ".") if has_comma else row[column]
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _RowError(column, f"{column} is {row[column]!r}, which is no number")
    return value
