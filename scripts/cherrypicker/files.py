"""Atomic writes, JSON, YAML, NPZ and CSV; the same bytes for the same content."""

import csv
import difflib
import io
import json
import math
import os
import re
import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from itertools import accumulate
from pathlib import Path
from typing import Any, NoReturn, TypeGuard

import numpy as np
import psutil
import yaml

from cherrypicker.errors import StageError

# What an installed library carries of the project beside itself (envs/wheel.py)
_CARRIED = Path(__file__).resolve().parent / "project"
# The folder of Snakefile, schema, networks and so on: the clone's root, or what a wheel carries
PROJECT = _CARRIED if _CARRIED.is_dir() else Path(__file__).resolve().parents[2]


def rounded(value: float) -> float:
    """Return six decimals: a micrometre in metric results, and a file that people can read."""
    return round(float(value), 6)


# One a line, or names in brackets. Parsing took half a second of every start; tests/test_house.py
# holds that the text tells as much as its syntax
_IMPORT = re.compile(r"^\s*from (cherrypicker[\w.]*) import (\([^)]*|.*)", re.MULTILINE)
# Far beyond what configs and edits need, far below where PyYAML's recursion ends (guess)
DEEPEST_YAML = 20


@contextmanager
def atomic_path(path: str | os.PathLike) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that takes its place if the block succeeds.

    The temporary name keeps the suffix, since many writers choose their format by it. A killed or
    failing writer leaves no half file under the final name; what a killed one left under the
    temporary name goes when the same file is written again.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    for left in leftovers(path.parent, f".{path.stem}.", f".part{path.suffix}"):
        left.unlink(missing_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        if error.filename is None:  # a full disk does not say whose write it refused
            error.filename = os.fspath(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def temporary_folder(parent: str | os.PathLike, prefix: str) -> Iterator[Path]:
    """Yield a new folder ``{prefix}{process id}`` in ``parent``, removed afterwards.

    What a killed process left there under that prefix goes first: it may be large.
    """
    parent = Path(parent)
    parent.mkdir(parents=True, exist_ok=True)
    for left in leftovers(parent, prefix):
        shutil.rmtree(left, ignore_errors=True)
    folder = parent / f"{prefix}{os.getpid()}"
    folder.mkdir()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def files_with(folder: str | os.PathLike, suffixes: Collection[str]) -> list[Path]:
    """Return a folder's files of some suffixes, lower case with their dot, sorted by name.

    Hidden files are left out; a missing folder has none.
    """
    folder = Path(folder)
    if not folder.is_dir():
        return []
    return sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and not path.name.startswith(".") and path.is_file()
    )


def written_at(path: Path) -> int:
    """When a file was written, nanoseconds by the clock of who wrote it; 0 where there is none."""
    return path.stat().st_mtime_ns if path.is_file() else 0


def leftovers(folder: Path, prefix: str, suffix: str = "") -> list[Path]:
    """Return what dead processes left in a folder as ``{prefix}{process id}{suffix}``.

    Snakemake's lock keeps other machines from writing the same file there.
    """
    pattern = re.compile(rf"{re.escape(prefix)}(\d+){re.escape(suffix)}")
    return sorted(
        path
        for path in folder.iterdir()
        if (match := pattern.fullmatch(path.name)) and not _is_at_work(int(match[1]), path)
    )


def _is_at_work(process_id: int, path: Path) -> bool:
    """Whether the process that made a path lives.

    A process or thread that started after the path's last change only bears the number again: a
    busy machine hands out its 32 768 anew within minutes. The file server's clock may be behind by
    as long as this process runs; one process at a time writes a path.
    """
    try:
        process = psutil.Process(process_id)
        return (
            process.status() != psutil.STATUS_ZOMBIE
            and process.create_time() <= path.stat().st_mtime
        )
    except (psutil.NoSuchProcess, FileNotFoundError):
        return False
    except psutil.AccessDenied:
        return True


def write_text(path: str | os.PathLike, text: str) -> None:
    """Write UTF-8 text atomically with Unix line ends."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def csv_text(
    rows: Iterable[Mapping[str, object]], columns: Iterable[str], delimiter: str = ","
) -> str:
    """Return rows as CSV with a header; the cell of None, or of none, is empty."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(columns), delimiter=delimiter, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def write_json(path: str | os.PathLike, content: object, *, indent: int | None = 2) -> None:
    """Write ``content`` as JSON, indented or on one line, NumPy numbers and arrays as plain ones.

    Raises
    ------
    ValueError
        If a number is not finite, which JSON cannot hold.
    """
    text = json.dumps(content, indent=indent, ensure_ascii=False, allow_nan=False, default=_plain)
    write_text(path, text + "\n")


class MissingKeyError(StageError, KeyError):
    """A record lacks a key; a `KeyError` too, for pages and others that go on without it."""

    __str__ = StageError.describe


class _Record(dict):
    """An object of a JSON file."""

    def __init__(self, path: str | os.PathLike, pairs: Iterable[tuple[str, Any]]) -> None:
        super().__init__(pairs)
        self._path = path

    def __missing__(self, key: object) -> NoReturn:
        raise MissingKeyError(f"the record has no {key!r}", file=self._path)

    def __reduce__(self) -> tuple:
        return dict, (dict(self),)


def read_json(path: str | os.PathLike) -> dict:
    """Read a JSON object; a missing or broken file is a :class:`StageError`.

    So is, later, a look for a key that it or an object in it lacks.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
        content = json.loads(text, object_pairs_hook=partial(_Record, path))
    except FileNotFoundError as error:
        raise StageError("the file is missing", file=path) from error
    except (ValueError, RecursionError) as error:
        raise StageError(f"not valid JSON ({error})", file=path) from error
    if not isinstance(content, dict):
        raise StageError(f"expected a JSON object, got {type(content).__name__}", file=path)
    return content


# Schemas are read at every start; written in C, the same loader takes a sixth of the time.
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def load_yaml(path: str | os.PathLike) -> dict:
    """Read a schema, or another table of the project's own, from YAML.

    It has the properties of those as well that its ``also`` lists, files beside it.
    """
    with open(path, encoding="utf-8") as stream:
        schema = yaml.load(stream, Loader=_LOADER)
    for name in schema.pop("also", []):
        schema["properties"] |= load_yaml(Path(path).with_name(name))["properties"]
    return schema


class _Loader(yaml.SafeLoader):
    """Refuses a key that stands twice in a mapping, of which YAML's loaders keep the last."""

    def compose_mapping_node(self, anchor: str | None) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                line = key.start_mark.line + 1
                raise ValueError(f"the key {key.value!r} stands a second time in line {line}")
            seen.add(key.value)
        return node


def parse_yaml(text: str) -> object:
    """Return what a YAML text holds, plain values alone, if it is as small as it looks.

    Lists that lie deep in one another, and anchors that are made of others, make a reader of a
    short text work long.

    Raises
    ------
    ValueError
        If it is no YAML, names a key twice, nests deeper than `DEEPEST_YAML`, or names an anchor
        inside another.
    """
    depth, anchored_at = 0, math.inf
    try:
        for event in yaml.parse(text, yaml.SafeLoader):
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
                if event.anchor:
                    anchored_at = min(anchored_at, depth)
            elif isinstance(event, yaml.CollectionEndEvent):
                anchored_at = math.inf if depth <= anchored_at else anchored_at
                depth -= 1
            elif isinstance(event, yaml.AliasEvent) and depth >= anchored_at:
                raise ValueError(f"the anchor {event.anchor!r} is named inside another")
            if depth > DEEPEST_YAML:
                raise ValueError(f"lists lie deeper than {DEEPEST_YAML} in one another")
        return yaml.load(text, Loader=_Loader)  # a SafeLoader
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error
    # Of a tag whose value is none such, of a number to the base 60 (1:30) that no float holds
    except (LookupError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"a value does not fit its tag ({error!r})") from error


def write_npz(path: str | os.PathLike, **arrays: np.ndarray | np.generic) -> None:
    """Write arrays to an uncompressed NPZ atomically; equal arrays give equal bytes."""
    for name, array in arrays.items():
        if np.asarray(array).dtype == object:
            raise ValueError(f"array {name!r} has dtype object, which NPZ would have to pickle")
    with atomic_path(path) as temporary, open(temporary, "wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]  # none is called allow_pickle


def read_npz(path: str | os.PathLike, required: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    """Read every array of an NPZ without unpickling anything.

    Raises
    ------
    StageError
        If the file is missing, no NPZ, holds pickled objects, or lacks a required array.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except FileNotFoundError as error:
        raise StageError("the file is missing", file=path) from error
    except Exception as error:  # NumPy's, zipfile's and zlib's share no base of their own
        raise StageError(f"not a readable NPZ of plain arrays ({error})", file=path) from error
    odd = [name for name, array in arrays.items() if not isinstance(array, np.ndarray)]
    if odd:  # NumPy hands out what has no array's header as bytes
        raise StageError(f"{', '.join(odd)} is no plain array", file=path)
    missing = [name for name in required if name not in arrays]
    if missing:
        raise StageError(f"array(s) {', '.join(missing)} missing", file=path)
    return arrays


def read_table(
    path: str | os.PathLike, required: tuple[str, ...] = (), delimiter: str = ","
) -> list[tuple[int, dict[str, str]]]:
    """Read the rows of a CSV with a header, each with its line number.

    Of several delimiters the one counts that the header has most of.

    Raises
    ------
    StageError
        If the file cannot be read, has no row, lacks a required column, or has a row that ends
        before one.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as stream:
            delimiter = max(delimiter, key=stream.readline().count)
            stream.seek(0)
            reader = csv.DictReader(stream, delimiter=delimiter)
            named = reader.fieldnames or ()
            rows = [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise StageError(f"cannot be read: {error}", file=path) from error
    missing = [name for name in required if name not in named]
    if missing or not rows:
        raise StageError(f"no {', '.join(missing) or 'rows'} in the table", file=path)
    if any(row[name] is None for _, row in rows for name in required):
        raise StageError("a row is shorter than the header", file=path)
    return rows


def read_user_table(
    path: str | os.PathLike,
    title: str,
    columns: Sequence[str],
    needed: Sequence[str],
    *,
    separators: str = "\t",
    key: str | None = None,
) -> tuple[list[tuple[int, dict[str, str]]], str]:
    """Read a table that a user writes, with a head.

    A byte order mark, CRLF line ends, blank lines and lines that start with ``#`` are allowed.

    Parameters
    ----------
    title : str
        What to call the table in an error.
    columns, needed : sequence of str
        Those that it may have, and must.
    separators : str
        The one that the head has most of separates the cells.
    key : str, optional
        Config key that names the table.

    Returns
    -------
    rows : list of (int, dict)
        Line of the file and cells by column, stripped, "" where there is none.
    separator : str
        "" for a file without a head.

    Raises
    ------
    StageError
        For a file that cannot be read, an unknown, doubled or missing column, or a row that is
        longer than the head.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        cause = f"{title} cannot be read ({error.strerror})"
        raise StageError(cause, file=path, key=key) from error
    except UnicodeDecodeError as error:
        raise StageError(f"{title} is not UTF-8", file=path, key=key) from error
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip(" " + separators) and not line.startswith("#")
    ]
    if not lines:
        return [], ""
    separator = max(separators, key=lines[0][1].count)
    try:
        rows = list(csv.reader((line for _, line in lines), delimiter=separator))
    except csv.Error as error:
        raise StageError(f"{title} cannot be read ({error})", file=path, key=key) from error
    if len(rows) != len(lines):
        cause = f"a cell of {title} spans several lines: a quote too many?"
        raise StageError(cause, file=path, key=key)
    head = [name.strip() for name in rows[0]]
    for name in head:
        if name not in columns:
            if len(head) == 1 and set(columns) & set(re.split(r"[\s,;]+", name)):
                marks = "tabs" if separators == "\t" else "commas, semicolons or tabs"
                cause = f"the columns of {title} are to be separated by {marks}, not as {name!r}"
                raise StageError(cause, file=path, key=key)
            near = difflib.get_close_matches(name, columns, n=1, cutoff=0.0)[0]
            cause = f"unknown column {name!r}; did you mean {near!r}?"
            raise StageError(cause, file=path, key=name)
    if len(set(head)) != len(head):
        raise StageError("a column is named twice", file=path)
    for name in needed:
        if name not in head:
            raise StageError(f"the column {name!r} is missing", file=path, key=name)
    found = []
    for (number, _), cells in zip(lines[1:], rows[1:], strict=True):
        if any(cell.strip() for cell in cells[len(head) :]):
            raise StageError(f"line {number} has more cells than the header", file=path, key=key)
        given = {name: cell.strip() for name, cell in zip(head, cells, strict=False)}
        found.append((number, dict.fromkeys(columns, "") | given))
    return found, separator


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether a value of a YAML or JSON file is a finite number; true and false are none."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:  # a whole number beyond what a float holds
        return False


def cell_number(
    text: str | None, path: str | os.PathLike, line: int, missing: float | None = None
) -> float:
    """Turn a cell of a table into a number; ``missing``, if given, for an empty cell or NaN.

    Raises
    ------
    StageError
        If the cell holds no finite number.
    """
    try:
        value = float(text or "nan")
    except ValueError:
        value = math.inf
    if math.isnan(value) and missing is not None:
        return missing
    if not math.isfinite(value):
        raise StageError(f"row {line}: {text!r} is no number", file=path)
    return value


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"cannot write {type(value).__name__} as JSON")


@cache
def imports_of(path: Path, root: Path) -> dict[Path, set[str]]:
    """The files in a folder, parents' ``__init__`` too, that a file imports; names from each."""
    taken: dict[str, set[str]] = {}
    for package, members in _IMPORT.findall(path.read_text(encoding="utf-8")):
        for name in re.findall(r"\w+", members):
            for up in accumulate(f"{package}.{name}".split("."), "{}/{}".format):
                taken.setdefault(up, set())
            taken[package.replace(".", "/")].add(name)
    files = {file: names for name, names in taken.items() for file in _module_files(name, root)}
    files.pop(path, None)
    return files


@cache
def _module_files(name: str, root: Path) -> list[Path]:
    """The files of a module or a package, ``a/b``, that are there; most are imported often."""
    return [file for file in (root / f"{name}.py", root / name / "__init__.py") if file.is_file()]
