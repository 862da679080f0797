"""Which library modules a stage script relies on, so that Snakemake can watch them.

Snakemake tracks a rule's script by its time and never what it imports; the rules therefore have a
digest of both, wherever they lie, among their params.
"""

from __future__ import annotations

import hashlib
import os
import re
from functools import cache
from pathlib import Path

PACKAGES = ("cherrypicker", "cherrypicker_lab")
# One statement a line, or names in brackets. Parsing took half a second of every start;
# tests/test_house.py holds that the text tells as much as its syntax
_IMPORT = re.compile(
    r"^\s*(?:from (cherrypicker[\w.]*) import (\([^)]*|.*)|import (cherrypicker[\w.]*))",
    re.MULTILINE,
)


def imported_modules(script: str | os.PathLike, root: str | os.PathLike) -> list[str]:
    """Return the files of our packages that a script imports, directly or not, sorted.

    Parameters
    ----------
    root : path-like
        The folder that holds the packages.

    Raises
    ------
    FileNotFoundError
        If the script, or a module that it imports from a package, does not exist.
    """
    root = Path(root).resolve()
    found: set[Path] = set()
    waiting = [Path(script).resolve()]
    while waiting:
        new = _imports_of(waiting.pop(), root) - found
        found |= new
        waiting += new
    return sorted(map(str, found))


@cache
def digest_of_code(
    script: str | os.PathLike, root: str | os.PathLike, patterns: tuple[Path, ...] = ()
) -> str:
    """Return a digest of the content of a script and what it imports, wherever all that lies.

    Parameters
    ----------
    root : path-like
        The folder that holds the packages.
    patterns : tuple of Path
        Files that it reads as well; their last part may be a pattern. One that is missing is for
        the stage to report.

    Raises
    ------
    FileNotFoundError
        As :func:`imported_modules`.
    """
    files = [Path(script), *map(Path, imported_modules(script, root))]
    files += [path for each in patterns for path in sorted(each.parent.glob(each.name))]
    return hashlib.sha256(b"".join(map(_content, files))).hexdigest()[:16]


@cache
def _content(path: Path) -> bytes:
    return path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest()


@cache
def _imports_of(path: Path, root: Path) -> set[Path]:
    """The files behind a file's imports, the parents' ``__init__`` included."""
    modules: set[str] = set()
    members: set[str] = set()
    for package, names, module in _IMPORT.findall(path.read_text(encoding="utf-8")):
        modules.add(package or module)
        members.update(f"{package}.{name}" for name in re.findall(r"\w+", names))
    found: set[Path] = set()
    for name in modules | members:
        parts = name.split(".")
        if parts[0] not in PACKAGES:
            continue
        place = root.joinpath(*parts)
        if name in modules and not (place.is_dir() or place.with_suffix(".py").is_file()):
            raise FileNotFoundError(f"{place} is imported by {path} but does not exist")
        files = [root.joinpath(*parts[:depth], "__init__.py") for depth in range(1, len(parts) + 1)]
        found.update(filter(Path.is_file, [*files, place.with_suffix(".py")]))
    return found - {path}
