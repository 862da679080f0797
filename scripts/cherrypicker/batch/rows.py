"""Scans of several trees: which results a scan of the table stands for.

A scan whose ``crop.target_xy`` is ``all`` or a list of places has no traits of its own: its trees
are ``{scan}_1``, ``{scan}_2`` and so on, and share its row and its config.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from cherrypicker.batch.config import lookup
from cherrypicker.errors import StageError
from cherrypicker.files import read_json

logger = logging.getLogger(__name__)

__all__ = ["ALL", "KEY", "check_names", "names_found", "places_of", "split_name"]

KEY = "crop.target_xy"
ALL = "all"
_NUMBERED = re.compile(r"(.+)_([1-9][0-9]*)")


def places_of(settings: Mapping) -> str | list | None:
    """Return which trees of a scan its config asks for: ``all``, or a list of pairs of numbers.

    None for a scan of one tree.
    """
    value = lookup(settings, KEY)
    return value if value == ALL or (value and isinstance(value[0], list)) else None


def split_name(tree: str, scans: Iterable[str]) -> tuple[str, int] | None:
    """Return the scan of several trees that a name is of, and the number of the tree; else None."""
    found = _NUMBERED.fullmatch(tree)
    return (found[1], int(found[2])) if found and found[1] in set(scans) else None


def check_names(names: Iterable[str], scans: Iterable[str], table: str) -> None:
    """Refuse a row whose id is that of a tree of another row's scan.

    Raises
    ------
    StageError
    """
    folded = {scan.casefold(): scan for scan in scans}
    for name in names:
        whose = split_name(name.casefold(), folded)
        if whose:
            raise StageError(
                f"tree {name!r} bears the name of a tree of the scan {folded[whose[0]]!r}, whose "
                f"{KEY} asks for several; give one of them another id",
                file=table,
                key="tree",
            )


def names_found(scan: str, results: str = "results") -> list[str]:
    """Return the trees that were found in a scan; none where nobody has looked yet.

    A list that is broken stops its own scan alone: it is told, and counts as none.
    """
    path = _found(scan, results)
    if not path.is_file():
        return []
    try:
        return [f"{scan}_{int(one['number'])}" for one in read_json(path).get("trees", [])]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        reason = f"no list of trees in it ({error!r})"
    except StageError as error:
        reason = error.cause
    logger.warning(
        "tree %s: %s is broken; delete it, and the next run looks for the trees again: %s",
        *(scan, path, reason),
    )
    return []


def found_time(scan: str, results: str = "results") -> float:
    """Return when the trees of a scan were found, seconds; 0 where nobody has looked yet."""
    path = _found(scan, results)
    return path.stat().st_mtime if path.is_file() else 0.0


def _found(scan: str, results: str) -> Path:
    return Path(results) / scan / "trees.json"
