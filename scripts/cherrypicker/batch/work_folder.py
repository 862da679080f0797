"""Whether a run can write where it has to, asked before it starts."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from cherrypicker.errors import StageError


def check_writable(folders: Iterable[str | os.PathLike]) -> None:
    """Refuse folders that cannot be written; one that is not there yet is judged by its parent.

    Snakemake itself stops with a traceback, and takes the whole batch with it.

    Raises
    ------
    StageError
        Naming the first such folder.
    """
    for folder in map(Path, folders):
        nearest = folder
        while not nearest.exists() and nearest != nearest.parent:
            nearest = nearest.parent
        if not nearest.is_dir():
            raise StageError("a folder is needed here, and this is none", file=nearest)
        if not os.access(nearest, os.W_OK | os.X_OK):
            raise StageError(
                "the folder cannot be written: it is read-only, or not yours", file=nearest
            )
