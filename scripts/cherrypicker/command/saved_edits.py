"""A tree's hand corrections as the page sends them: looked at, then written to the work folder."""

import threading
from pathlib import Path

from cherrypicker.batch.batch import Batch
from cherrypicker.command.work_folder import results_of
from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path, written_at
from cherrypicker.skeleton import read_skeleton
from cherrypicker.skeleton.edits import apply_edits, read_edits

_writing = threading.Lock()


def edits_file(batch: Batch, tree: str) -> Path:
    """Return the file of a tree's corrections, whether it is there or not.

    A `StageError` where the config names none, or one outside the work folder.
    """
    name = batch.edits_of(tree)
    path = Path(name)
    if not name or not path.resolve().is_relative_to(Path.cwd().resolve()):
        cause = f"tree {tree}: edits are written to a file in the work folder alone"
        raise StageError(cause, file=name or None, key="graph.edits")
    return path


def save_edits(batch: Batch, tree: str, body: bytes) -> dict:
    """Write a tree's corrections, if they can be applied to it.

    The body is the file as config/README.md describes it; a key ``tree`` beside ``edits`` must name
    the tree. What comes has its ``path``, and ``lost``: a sentence for each edit that finds no
    node. A `StageError` for what is no list of edits, is of another tree, or would close a cycle.
    """
    path = edits_file(batch, tree)
    with _writing, atomic_path(path) as temporary:
        temporary.write_bytes(body)
        try:
            edits = read_edits(temporary, tree)
            names = "skeleton.graphml", "solved.graphml", "edits.json"
            skeleton, solved, told = (results_of(tree) / name for name in names)
            # As on the page, before its own edits: `edit_graph` writes edits.json after what it
            # makes of the solved one. A younger skeleton is the solver's own, the other is old
            if solved.is_file() and written_at(told) >= written_at(skeleton):
                skeleton = solved
            _, report = apply_edits(read_skeleton(skeleton), edits)
        except StageError as error:
            raise StageError(error.cause, file=path, key=error.key) from error
        if edits and not report["n_applied"]:
            raise StageError(f"no edit lies on tree {tree}: are they of another tree?", file=path)
    return {"path": str(path), "lost": report["lost"]}
