"""The table of the batch: one row a scan."""

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, fields

from cherrypicker.batch.config import first_refusal
from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml, read_user_table
from cherrypicker.ply import PlyError, vertex_properties
from cherrypicker.runner import SCHEMA_FILE

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
    """Read the table of trees and check it by its schema, row by row.

    A `StageError` for an unknown or missing column, a duplicate or unusable id, or a cell that is
    not valid; the message names the row.
    """
    rows, separator = read_user_table(path, "the table of trees", COLUMNS, ["tree"])
    if not separator:
        raise StageError("the table of trees has no header", file=path)
    schema = load_yaml(SCHEMA_FILE.with_name("trees.schema.yaml"))
    trees: dict[str, Tree] = {}
    for line, cells in rows:
        refusal = first_refusal(schema, {name: cell for name, cell in cells.items() if cell})
        if refusal:
            column, reason = refusal
            cause = f"line {line}, tree {cells['tree']!r}: {reason}"
            raise StageError(cause, file=path, key=column)
        if cells["tree"].casefold() in trees:
            cause = f"tree {cells['tree']!r} stands twice"
            cause += " (ids differ by more than upper and lower case)"
            raise StageError(cause, file=path, key="tree")
        trees[cells["tree"].casefold()] = Tree(**cells)
    return list(trees.values())


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

    A `StageError` where two series share a folder.
    """
    found: dict[str, list[Tree]] = {}
    for row in trees:
        if row.series:
            found.setdefault(folder_name(row.series), []).append(row)
    for folder, rows in found.items():
        first, *others = sorted({row.series for row in rows})
        if others:
            cause = f"the series {first!r} and {others[0]!r} share the folder {folder!r}"
            raise StageError(cause, key="series in trees.tsv")
    return {folder: rows for folder, rows in found.items() if len(rows) > 1}
