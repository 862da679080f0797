"""The table of the batch: one row a scan."""

from __future__ import annotations

import csv
import datetime
import difflib
import io
import math
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

from cherrypicker.errors import StageError
from cherrypicker.placement.late_cloud import parse_up_axis
from cherrypicker.ply import PlyError, vertex_properties
from cherrypicker.units import UNITS_M

TREE_PATTERN = r"[A-Za-z0-9_.\-]+"


@dataclass(frozen=True)
class Tree:
    """One row of ``config/trees.tsv``; an absent or empty cell is an empty string."""

    tree: str
    photos: str = ""
    masks: str = ""
    cloud: str = ""
    cloud_unit: str = ""
    cloud_up: str = ""
    marker_dictionary: str = ""
    marker_sides_m: str = ""
    scale: str = ""
    date: str = ""
    series: str = ""
    config: str = ""

    @property
    def is_photo_scan(self) -> bool:
        """Whether the scan starts from photos rather than from a ready cloud."""
        return bool(self.photos)

    def has_labelled_cloud(self) -> bool:
        """Whether the ready cloud is a PLY whose vertices carry a ``label``."""
        if not self.cloud.lower().endswith(".ply"):
            return False
        try:
            return "label" in vertex_properties(self.cloud)
        except (OSError, PlyError):
            return False


COLUMNS = tuple(column.name for column in fields(Tree))


def read_trees(path: str | os.PathLike) -> list[Tree]:
    """Read and check the table of trees.

    A byte order mark, CRLF line ends, blank lines and lines that start with ``#`` are allowed.

    Raises
    ------
    StageError
        For an unknown or missing column, a duplicate or unusable id, or a cell that is not valid;
        the message names the row.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise StageError(
            f"the table of trees cannot be read ({error.strerror})", file=path
        ) from error
    except UnicodeDecodeError as error:
        raise StageError("the table of trees is not UTF-8", file=path) from error
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.startswith("#")
    ]
    if not lines:
        raise StageError("the table of trees has no header", file=path)
    stream = io.StringIO("\n".join(line for _, line in lines))
    try:
        rows = list(csv.reader(stream, delimiter="\t"))
    except csv.Error as error:
        raise StageError(f"the table of trees cannot be read ({error})", file=path) from error
    header = [name.strip() for name in rows[0]]
    _check_header(header, path)
    trees = []
    for (number, _), cells in zip(lines[1:], rows[1:]):
        if len(cells) > len(header) and any(cell.strip() for cell in cells[len(header) :]):
            raise StageError(f"line {number} has more cells than the header", file=path)
        row = Tree(
            **{name: cell.strip() for name, cell in zip(header, cells)} | _no_id(header, cells)
        )
        _check_row(row, number, path)
        trees.append(row)
    _check_duplicates(trees, path)
    return trees


def any_of(names: Iterable[str]) -> str:
    """Return a wildcard constraint that matches these names only."""
    return "|".join(map(re.escape, names)) or "(?!)"


def none_of(names: Iterable[str]) -> str:
    """Return a wildcard constraint that matches all trees but these."""
    return rf"(?!(?:{any_of(names)})(?:/|$)){TREE_PATTERN}"


def folder_name(name: str, empty: str = "_") -> str:
    """Return a name as that of a folder of results: what one cannot have is an underscore."""
    return re.sub(rf"(?!{TREE_PATTERN}).", "_", name).lstrip(".") or empty


def series_of(trees: Iterable[Tree]) -> dict[str, list[Tree]]:
    """Return the series with two scans or more, by the name of their folder of results.

    Raises
    ------
    StageError
        If two series share a folder.
    """
    found: dict[str, list[Tree]] = {}
    for row in trees:
        if row.series:
            found.setdefault(folder_name(row.series), []).append(row)
    for folder, rows in found.items():
        names = sorted({row.series for row in rows})
        if len(names) > 1:
            raise StageError(
                f"the series {names[0]!r} and {names[1]!r} share the folder {folder!r}",
                key="series in trees.tsv",
            )
    return {folder: rows for folder, rows in found.items() if len(rows) > 1}


def _no_id(header: list[str], cells: list[str]) -> dict:
    """Give a row that is too short for its id an empty one, so that the check names the line."""
    return {} if len(cells) > header.index("tree") else {"tree": ""}


def _check_header(header: list[str], path: str | os.PathLike) -> None:
    for name in header:
        if name not in COLUMNS:
            near = difflib.get_close_matches(name, COLUMNS, n=1, cutoff=0.0)
            raise StageError(
                f"unknown column {name!r}; did you mean {near[0]!r}?", file=path, key=name
            )
    if len(set(header)) != len(header):
        raise StageError("a column is named twice", file=path)
    if "tree" not in header:
        raise StageError("the column 'tree' is missing", file=path, key="tree")
    if "photos" not in header and "cloud" not in header:
        raise StageError(
            "one of the columns 'photos' and 'cloud' is needed", file=path, key="photos"
        )


def _check_row(row: Tree, number: int, path: str | os.PathLike) -> None:
    def refuse(column: str, reason: str) -> None:
        raise StageError(f"line {number}, tree {row.tree!r}: {reason}", file=path, key=column)

    for column in COLUMNS:
        if re.search(r"[\x00-\x1f\x7f-\x9f]", getattr(row, column)):
            refuse(column, "a cell holds a control character")
    if not re.fullmatch(TREE_PATTERN, row.tree) or row.tree.strip(".") == "" or row.tree[0] == ".":
        refuse("tree", "an id has letters, digits, '-', '_' and '.', and does not start with '.'")
    if bool(row.photos) == bool(row.cloud):
        refuse("photos", "give exactly one of 'photos' and 'cloud'")
    if row.masks and row.cloud:
        refuse("masks", "a ready cloud has no photos to mask")
    if row.cloud_unit and row.cloud_unit not in UNITS_M and _positive(row.cloud_unit) is None:
        refuse(
            "cloud_unit", f"{row.cloud_unit!r} is none of {', '.join(UNITS_M)} nor metres per unit"
        )
    if row.cloud_up:
        try:
            parse_up_axis(row.cloud_up)
        except ValueError as error:
            refuse("cloud_up", str(error))
    if row.scale and row.scale not in ("marker", "none") and _positive(row.scale) is None:
        refuse("scale", f"{row.scale!r} is neither 'marker', 'none' nor a positive number")
    if row.scale == "marker" and row.cloud:
        refuse("scale", "a ready cloud has no photos to find a marker in; give a number or 'none'")
    if row.date:
        try:
            datetime.date.fromisoformat(row.date)
        except ValueError:
            refuse("date", f"{row.date!r} is no ISO date (YYYY-MM-DD)")


def _check_duplicates(trees: list[Tree], path: str | os.PathLike) -> None:
    seen: dict[str, str] = {}
    for row in trees:
        folded = row.tree.casefold()
        if folded in seen:
            raise StageError(
                f"tree {row.tree!r} stands twice (ids differ by more than upper and lower case)",
                file=path,
                key="tree",
            )
        seen[folded] = row.tree


def _positive(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) and value > 0 else None
