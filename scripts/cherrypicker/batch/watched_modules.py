"""Which library modules a stage script relies on, so that Snakemake can watch them.

Snakemake tracks a rule's script by its time and never what it imports; the rules therefore have a
digest of both, wherever they lie, among their params.
"""

import hashlib
from functools import cache
from pathlib import Path

from cherrypicker.files import imports_of


def imported_modules(script: Path, root: Path) -> list[str]:
    """Return the files of our packages, in `root`, that a script imports, directly or not, sorted.

    A `FileNotFoundError` where the script does not exist.
    """
    root = root.resolve()
    found: set[Path] = set()
    waiting = [script.resolve()]
    while waiting:
        new = imports_of(waiting.pop(), root).keys() - found
        found |= new
        waiting += new
    return sorted(map(str, found))


@cache
def digest_of_code(script: Path, root: Path, patterns: tuple[Path, ...]) -> str:
    """Return a digest of the content of a script and what it imports, wherever all that lies.

    So of the files that it reads as well, by `patterns` of their last part; one that is missing is
    for the stage to report. Raises what :func:`imported_modules` does.
    """
    files = [script, *map(Path, imported_modules(script, root))]
    files += [path for each in patterns for path in sorted(each.parent.glob(each.name))]
    return hashlib.sha256(b"".join(map(_content, files))).hexdigest()[:16]


@cache
def _content(path: Path) -> bytes:
    return path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest()
