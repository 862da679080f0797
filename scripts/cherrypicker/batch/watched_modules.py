"""Which library modules a stage script relies on, so that Snakemake can watch them.

Snakemake tracks a rule's script but never what it imports; the rules therefore have a digest of
the modules found here among their params.
"""

from __future__ import annotations

import ast
import hashlib
import os
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

PACKAGES = ("cherrypicker", "cherrypicker_lab")


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
        for module in _imports_of(waiting.pop(), root):
            if module not in found:
                found.add(module)
                waiting.append(module)
    return sorted(str(module) for module in found)


def digest_of_code(
    script: str | os.PathLike, root: str | os.PathLike, patterns: Iterable[Path] = ()
) -> str:
    """Return a digest of the content of what a script imports, wherever all that lies.

    Parameters
    ----------
    root : path-like
        The folder that holds the packages.
    patterns : iterable of Path
        Files that it reads as well; their last part may be a pattern. One that is missing is for
        the stage to report.

    Raises
    ------
    FileNotFoundError
        As :func:`imported_modules`.
    """
    digest = hashlib.sha256()
    for module in imported_modules(script, root):
        digest.update(_content(Path(module)))
    for pattern in patterns:
        for path in sorted(pattern.parent.glob(pattern.name)):
            digest.update(_content(path))
    return digest.hexdigest()[:16]


@cache
def _content(path: Path) -> bytes:
    return path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest()


@cache
def _imports_of(path: Path, root: Path) -> tuple[Path, ...]:
    tree = ast.parse(path.read_text(encoding="utf-8"), filename=str(path))
    modules: set[Path] = set()
    for node in _imports_in(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                modules.update(_files_of(alias.name, (), root))
        else:
            name = _absolute_name(node, path, root)
            modules.update(_files_of(name, tuple(alias.name for alias in node.names), root))
    return tuple(sorted(modules - {path}))


def _imports_in(block: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Yield a block's imports, those of the blocks in it too; no expression holds one."""
    for node in ast.iter_child_nodes(block):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            yield node
        elif isinstance(node, (ast.stmt, ast.excepthandler, ast.match_case)):
            yield from _imports_in(node)


def _absolute_name(node: ast.ImportFrom, path: Path, root: Path) -> str:
    if node.level == 0:
        return node.module or ""
    parts = path.relative_to(root).with_suffix("").parts
    package = parts[: len(parts) - node.level]
    return ".".join([*package, *([node.module] if node.module else [])])


def _files_of(name: str, members: tuple[str, ...], root: Path) -> set[Path]:
    """Return the files behind ``from name import members``, parents' __init__ included."""
    parts = name.split(".")
    if parts[0] not in PACKAGES:
        return set()
    files = {root.joinpath(*parts[:depth], "__init__.py") for depth in range(1, len(parts))}
    folder = root.joinpath(*parts)
    if folder.is_dir():
        files.add(folder / "__init__.py")
        for member in members:
            if (folder / f"{member}.py").is_file():
                files.add(folder / f"{member}.py")
            elif (folder / member / "__init__.py").is_file():
                files.add(folder / member / "__init__.py")
    else:
        files.add(folder.with_suffix(".py"))
    for path in files:
        if not path.is_file():
            raise FileNotFoundError(f"{path} is imported but does not exist")
    return files
