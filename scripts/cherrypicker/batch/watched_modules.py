"""Which library modules a stage script relies on, so that Snakemake can watch them.

Snakemake tracks a rule's script by its time and never what it imports; the rules therefore have a
digest of both, wherever they lie, among their params.
"""

import hashlib
import os
import re
from functools import cache
from pathlib import Path

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
        If the script does not exist.
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
    names: set[str] = set()
    for package, members, module in _IMPORT.findall(path.read_text(encoding="utf-8")):
        names |= {package or module, *(f"{package}.{each}" for each in re.findall(r"\w+", members))}
    files = {root.joinpath(*name.split(".")).with_suffix(".py") for name in names}
    for name in names:
        parts = name.split(".")
        files |= {root.joinpath(*parts[: i + 1], "__init__.py") for i in range(len(parts))}
    return set(filter(Path.is_file, files)) - {path}
