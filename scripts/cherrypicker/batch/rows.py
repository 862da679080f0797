"""Scans of several trees: which results a scan of the table stands for.

A scan whose ``crop.target_xy`` is ``all`` or a list of places has no traits of its own: its trees
are ``{scan}_1``, ``{scan}_2`` and so on, and share its row and its config.
"""

import logging
import re
from collections.abc import Collection, Mapping
from pathlib import Path

from cherrypicker.batch.config import lookup
from cherrypicker.batch.trees import Tree
from cherrypicker.errors import StageError
from cherrypicker.files import read_json

logger = logging.getLogger(__name__)

KEY = "crop.target_xy"
ALL = "all"
_NUMBERED = re.compile(r"(.+)_([1-9][0-9]*)")


def split_name(tree: str, scans: Collection[str]) -> tuple[str, int]:
    """Return the row that a tree is from, and its number in a scan of several; 0 of the row."""
    found = _NUMBERED.fullmatch(tree)
    return (found[1], int(found[2])) if found and found[1] in scans else (tree, 0)


def scans_of_several(
    trees: Mapping[str, Tree], settings_of: Mapping[str, dict], table: str, source: str
) -> dict[str, str | list]:
    """Return which trees are asked for of each scan of several: ``all``, or pairs of numbers.

    A `StageError`, of the table of trees, for a row whose id is that of a tree of another row's
    scan, or, of the tree's config or the ``source`` of all others, for a series whose trees would
    not keep their numbers.
    """
    several: dict[str, str | list] = {}
    for name in trees:
        places = lookup(settings_of[name], KEY)
        if places == ALL or (places and isinstance(places[0], list)):
            several[name] = places
    folded = {scan.casefold(): scan for scan in several}
    for name, row in trees.items():
        scan, number = split_name(name.casefold(), folded)
        if number:
            cause = f"tree {name!r} bears the name of a tree of the scan {folded[scan]!r}, whose "
            cause += f"{KEY} asks for several; give one of them another id"
            raise StageError(cause, file=table, key="tree")
        if several.get(name) == ALL and row.series:
            cause = f"tree {name!r}: the trees of a series must keep their numbers; give a list of "
            cause += "places, in one order for all dates"
            raise StageError(cause, file=row.config or source, key=KEY)
    return several


def names_found(scan: str) -> list[str]:
    """Return the trees that were found in a scan; none where nobody has looked yet.

    A list that is broken stops its own scan alone: it is told, and counts as none.
    """
    path = Path("results", scan, "trees.json")
    if not path.is_file():
        return []
    try:
        names = [f"{scan}_{int(one['number'])}" for one in read_json(path).get("trees", [])]
        if not all(split_name(name, [scan])[1] for name in names):
            raise ValueError("its trees count from 1")
        return names
    except (StageError, TypeError, ValueError, OverflowError) as error:
        logger.warning(
            "tree %s: %s is broken; delete it, and the next run looks for the trees again: %s",
            *(scan, path, getattr(error, "cause", error)),
        )
        return []
