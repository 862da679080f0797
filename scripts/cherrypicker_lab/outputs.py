"""Figures to files, and two folders of results beside one another, byte for byte."""

from __future__ import annotations

import filecmp
import os
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from matplotlib.figure import Figure

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path


def save(figure: Figure, path: str | os.PathLike) -> None:
    """Write a figure as PNG, atomically and without a date."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=100, format="png", metadata={"Software": None})


@dataclass(frozen=True)
class Comparison:
    """What two folders have in common; paths below them, in order."""

    equal: list[str]  # files of the same bytes
    different: list[str]
    # missing, added: files of the first folder alone, and of the second alone
    missing: list[str]
    added: list[str]

    @property
    def is_equal(self) -> bool:
        """Whether both hold the same files with the same bytes, one at least."""
        return bool(self.equal) and not (self.different or self.missing or self.added)

    def describe(self) -> str:
        """Return a line a file that is not equal, then the counts."""
        lines = [f"differs: {path}" for path in self.different]
        lines += [f"only before: {path}" for path in self.missing]
        lines += [f"only after: {path}" for path in self.added]
        n_all = len(self.equal) + len(lines)
        return "\n".join([*lines, f"{len(self.equal)} of {n_all} files equal byte for byte"])


def compare_folders(
    before: str | os.PathLike, after: str | os.PathLike, ignore: Sequence[str] = ()
) -> Comparison:
    """Compare all files below two folders.

    Parameters
    ----------
    before, after : path-like
    ignore : sequence of str
        Patterns of paths below the folders that are passed over, ``*/sfm/*`` for instance.

    Raises
    ------
    StageError
        If one of them is no folder.
    """
    first, second = _files_below(before, ignore), _files_below(after, ignore)
    equal, different = [], []
    for path in sorted(first & second):
        is_same = filecmp.cmp(Path(before, path), Path(after, path), shallow=False)
        (equal if is_same else different).append(path)
    return Comparison(equal, different, sorted(first - second), sorted(second - first))


def _files_below(folder: str | os.PathLike, ignore: Sequence[str]) -> set[str]:
    root = Path(folder)
    if not root.is_dir():
        raise StageError("no such folder", file=root)
    found = {path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()}
    return {path for path in found if not any(fnmatch(path, pattern) for pattern in ignore)}
