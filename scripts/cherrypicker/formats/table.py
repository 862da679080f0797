"""The formats that a finished tree is written in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cherrypicker.formats.measured import MeasuredTree, read_measured_tree
from cherrypicker.formats.treeqsm_csv import write_treeqsm_csv


@dataclass(frozen=True)
class Format:
    """A format: what it is, its file's suffix, and what writes it from a tree's results."""

    title: str
    suffix: str
    write: Callable[[Path, Path], None]


def _of_tree(write: Callable[[Path, MeasuredTree], None]) -> Callable[[Path, Path], None]:
    """Return a writer that reads the measured tree first."""
    return lambda path, folder: write(path, read_measured_tree(folder))


FORMATS = {
    "treeqsm-csv": Format(
        "cylinders as TreeQSM's, for rTwig", "_cylinders.csv", _of_tree(write_treeqsm_csv)
    ),
}
