"""The work folder that a subcommand or a run is about."""

import argparse
import os
from collections.abc import Iterable
from pathlib import Path

from cherrypicker.batch.batch import Batch, read_batch
from cherrypicker.batch.config import read_config_file
from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml
from cherrypicker.runner import SCHEMA_FILE, stage_parser


def folder_parser(doc: str | None) -> argparse.ArgumentParser:
    """Return a parser with the subcommand's text and the option ``--directory``."""
    parser = stage_parser(doc)
    parser.add_argument(
        *("-d", "--directory"),
        default=".",
        help="work folder, with config/trees.tsv; default the current one",
    )
    return parser


def from_here(path: str) -> Path:
    """Return a path as an absolute one, since the work folder is entered before it is used."""
    return Path(path).absolute()


def check_writable(folders: Iterable[str | os.PathLike]) -> None:
    """Refuse folders that cannot be written; one that is not there yet is judged by its parent.

    Snakemake itself stops with a traceback, and takes the whole batch with it. The `StageError`
    names the first such folder.
    """
    for folder in map(Path, folders):
        nearest = next(filter(Path.exists, (folder, *folder.parents)), folder)
        if not nearest.is_dir():
            raise StageError("a folder is needed here, and this is none", file=nearest)
        if not os.access(nearest, os.W_OK | os.X_OK):
            cause = "the folder cannot be written: it is read-only, or not yours"
            raise StageError(cause, file=nearest)


def batch_here() -> Batch:
    """Read table and config of the current folder; raises what `read_batch` does."""
    return read_batch(load_yaml(SCHEMA_FILE), read_config_file(may_miss=True))


def results_of(tree: str) -> Path:
    """Return the folder of a tree's results in the current work folder.

    A `StageError` where there are none.
    """
    folder = Path("results") / tree
    if not (folder / "skeleton.graphml").is_file():
        cause = f"tree {tree}: there is no finished skeleton; cherrypicker run makes it"
        raise StageError(cause, file=folder)
    return folder
