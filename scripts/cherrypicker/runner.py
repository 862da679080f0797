"""Run a stage's ``main`` from Snakemake or from the command line, with one way to log and to fail.

Under Snakemake the rule's named inputs, outputs and params are the keyword arguments of ``main``.
Its parameters are the files of the stage, each with its text in ``Annotated``; its options are the
keyword-only ones that have a type: a dataclass stands for its fields, and ``main`` takes an
instance. Config keys of the same name, which the schema says the stage reads,
give their values under Snakemake and their text on the command line.
The rule's log takes everything, native output of COLMAP and Open3D too; the console gets progress,
warnings and, when the stage fails, one line. A status file below ``logs/status`` tells the batch
summary which stage of which tree failed, and why; one that still says "running" after the run was
killed.
"""

import argparse
import errno
import faulthandler
import inspect
import logging
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, NamedTuple, TextIO, Union, get_args, get_origin, get_type_hints

from threadpoolctl import ThreadpoolController

from cherrypicker.errors import StageError
from cherrypicker.files import PROJECT, load_yaml, write_json

logger = logging.getLogger(__name__)

SCHEMA_FILE = PROJECT / "workflow/schemas/config.schema.yaml"
NO_TREE = "_batch"
_TEXT = {"threads": "Threads of the stage.", "gpu": "1 to use an NVIDIA GPU."}
_LITTLE_ROOM_BYTES = 500_000_000
_DISK_ERRORS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EROFS: "the folder is read-only",
    errno.EACCES: "no permission",
    errno.EPERM: "no permission",
}


def status_folder(tree: str = NO_TREE) -> Path:
    """Return the folder of the records of a tree's stages, or of the rules that are of no tree."""
    return Path("logs/status", tree)


def status_file(rule: str, wildcards: Mapping[str, str]) -> Path:
    """Return the file of a job's record; other wildcards than the tree keep jobs apart."""
    others = [str(each).replace("/", "_") for name, each in wildcards.items() if name != "tree"]
    return status_folder(wildcards.get("tree", NO_TREE)) / f"{'.'.join([rule, *others])}.json"


def told_of(wildcards: Mapping[str, str]) -> str:
    """Return what a job is of, as its failure names it on the console."""
    return " ".join(f"{name}={value}" for name, value in (wildcards or {"tree": NO_TREE}).items())


def failure_told(record: Mapping) -> str:
    """Return what the record of a failed job tells, as the console has it."""
    file, key, log = (record.get(name) or None for name in ("file", "key", "log"))
    why = StageError(record["cause"], file=file, key=key).describe()
    return f"{why}; log: {log}" if log else why


class Option(NamedTuple):
    """An option of a stage: a typed keyword of its ``main``, or a field of its class."""

    kind: type
    default: object
    holder: str = ""  # the keyword whose class has the field; empty for a keyword of its own


def options_of(main: Callable) -> dict[str, Option]:
    """Return the options of a stage by name.

    Raises
    ------
    TypeError
        If two of them bear one name.
    """
    found: dict[str, Option] = {}
    for name, keyword in inspect.signature(main, eval_str=True).parameters.items():
        kind = keyword.annotation
        if keyword.kind is not keyword.KEYWORD_ONLY or kind is keyword.empty:
            continue
        more = {name: Option(kind, keyword.default)}
        if isinstance(kind, type) and is_dataclass(kind):
            defaults, kinds = kind(), get_type_hints(kind)
            names = [field.name for field in fields(kind)]
            more = {each: Option(kinds[each], getattr(defaults, each), name) for each in names}
        if found.keys() & more.keys():
            raise TypeError(f"two options are named {', '.join(found.keys() & more.keys())}")
        found |= more
    return found


def keys_of_stage(schema: Mapping, stage: str) -> dict[str, dict]:
    """Return the config keys that a stage reads, dotted, with their schemas.

    The schema names the stages that read a key in the key's ``stages``, or in its section's.
    """
    found: dict[str, dict] = {}
    for name, section in schema["properties"].items():
        keys = {name: section}
        if section.get("default") == {}:  # a section of a section is one key
            keys = {f"{name}.{key}": each for key, each in section["properties"].items()}
        shared = section.get("stages", ())
        found |= {key: each for key, each in keys.items() if stage in each.get("stages", shared)}
    return found


def stage_parser(doc: str | None, main: Callable | None = None) -> argparse.ArgumentParser:
    """Return the argument parser of a script from its module docstring and the files of ``main``.

    What is no option of ``main`` is a file: ``cloud: Annotated[str, "metric.ply"]`` says what it
    is, and whether it can be left out. A script without ``main`` here adds its own arguments.
    """
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, given in inspect.signature(main, eval_str=True).parameters.items() if main else ():
        if given.kind is given.POSITIONAL_OR_KEYWORD:
            kind, text = get_args(given.annotation)
            needed = given.default is given.empty
            default = None if needed else given.default
            parser.add_argument(
                f"--{name}", required=needed, default=default, help=text, **_reading(kind)
            )
    return parser


def add_options(parser: argparse.ArgumentParser, main: Callable) -> None:
    """Add a stage's options to its parser, with the text of their config keys."""
    schema = load_yaml(SCHEMA_FILE)
    keys = keys_of_stage(schema, Path(main.__code__.co_filename).stem)
    described = {key.rpartition(".")[2]: (key, each) for key, each in keys.items()}
    for name, option in options_of(main).items():
        key, each = described.get(name, ("", {}))
        text = each.get("description") or _TEXT.get(name, "")
        source = f"config key {key}, " if key else ""
        parser.add_argument(
            f"--{name}",
            default=option.default,
            choices=each.get("enum"),
            help=f"{text.strip()} [{source}default {option.default}]".replace("%", "%%").strip(),
            **_reading(option.kind),
        )


def _reading(kind: type) -> dict:
    """Return how argparse reads a type: its converter and number of values."""
    if get_origin(kind) in (UnionType, Union):
        (kind,) = (each for each in get_args(kind) if each is not NoneType)
    origin, parts = get_origin(kind), get_args(kind)
    if kind is bool:
        return {"type": _flag, "nargs": "?", "const": True, "metavar": "true|false"}
    if origin is dict:
        return {"type": _pairs, "metavar": "NAME:NUMBER,..."}
    if origin is tuple and parts[-1] is not Ellipsis:
        return {"type": parts[0], "nargs": len(parts)}
    if origin in (tuple, list, Sequence):
        return {"type": parts[0], "nargs": "*"}
    return {"type": kind}


def _flag(text: str) -> bool:
    """Parse ``true`` or ``false``."""
    if text.lower() not in ("true", "false"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither true nor false")
    return text.lower() == "true"


def _pairs(text: str) -> dict[str, float]:
    """Parse ``name:number`` pairs with commas between."""
    try:
        return {name: float(value) for name, value in (p.split(":") for p in text.split(","))}
    except ValueError:
        message = f"{text!r} is no list such as trunk:10,branch:1"
        raise argparse.ArgumentTypeError(message) from None


def keep_openblas_to_one_thread() -> None:
    """Limit each OpenBLAS that is loaded by now; numpy, scipy and OpenCV bring one of their own.

    A stage has the threads that its rule grants. Theirs, one a core of the machine, come on top,
    and wait in a loop for matrices that are too small for them.
    """
    ThreadpoolController().select(internal_api="openblas").limit(limits=1)


def run(main: Callable, parser: argparse.ArgumentParser, snakemake: object | None = None) -> None:
    """Call ``main`` with the arguments of the rule, or of the command line (no `snakemake` object).

    Does nothing when the script is imported rather than run. ``main`` takes its own options and the
    parser's destinations, which bear the names of the rule's inputs, outputs and params;
    ``threads`` and ``gpu`` take the rule's threads and GPU resource.

    Raises
    ------
    SystemExit
        With code 1 when the stage fails; the reason has been printed on one line.
    """
    if main.__module__ != "__main__":
        return
    keep_openblas_to_one_thread()
    if snakemake is not None:
        _run_from_rule(main, parser, snakemake)
        return
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    add_options(parser, main)
    try:
        main(**_bundled(main, vars(parser.parse_args())))
    except (StageError, OSError) as error:
        logger.error("error: %s", StageError(**_explain(error)).describe())
        raise SystemExit(1) from None


def _run_from_rule(main: Callable, parser: argparse.ArgumentParser, snakemake: Any) -> None:
    rule = snakemake.rule
    log_path = str(snakemake.log[0]) if len(snakemake.log) else os.devnull
    wildcards = dict(snakemake.wildcards.items())
    console = _redirect_output(log_path, f"[{' '.join([*wildcards.values(), rule])}]")
    status = status_file(rule, wildcards)
    stamp = "%Y-%m-%dT%H:%M:%S%z"
    record = {"state": "running", "rule": rule, "tree": NO_TREE} | wildcards
    record |= {"log": log_path, "time": time.strftime(stamp)}
    try:
        write_json(status, record)
        # What the Snakefile found wrong with the tree's row, before any work is done for it
        if problem := dict(snakemake.params.items()).get("problem"):
            raise StageError(**problem)
        main(**_bundled(main, _arguments(parser, main, snakemake)))
    except Exception as error:
        logger.exception("the stage failed")
        failure = _explain(error, snakemake.output)
    else:
        status.unlink(missing_ok=True)
        return
    whose = told_of(wildcards)
    # The console first: on a full disk it is all that is left to tell the reason. On a line of
    # its own, since Snakemake writes its texts and their ends one by one into the same stream.
    console.write(f"\nERROR {whose} rule={rule}: {failure_told(record | failure)}\n")
    console.flush()
    try:
        write_json(status, record | failure | {"state": "failed", "time": time.strftime(stamp)})
    except OSError as error:
        console.write(f"this failure of {whose} could not be noted in {status} ({error})\n")
        console.flush()
    raise SystemExit(1)


def _explain(error: Exception, outputs: Iterable[str] = ()) -> dict:
    """Return cause, file and key of a failure as a user reads them."""
    if isinstance(error, StageError):
        return error.arguments()
    if isinstance(error, OSError) and error.errno in _DISK_ERRORS:
        reason = f"{_DISK_ERRORS[error.errno]} ({os.strerror(error.errno)})"
        file = None if error.filename is None else os.fsdecode(error.filename)
        return {"cause": reason, "file": file, "key": None}
    detail = " ".join(str(error).split())
    cause = f"unexpected {type(error).__name__}: {detail}{_disk_hint(outputs)}"
    return {"cause": cause, "file": None, "key": None}


def _disk_hint(outputs: Iterable[str]) -> str:
    """Say how little room is left: COLMAP does not tell when a full disk is its trouble."""
    for output in outputs:
        folder = Path(output).parent
        try:
            free = shutil.disk_usage(folder).free
        except OSError:
            continue
        if free < _LITTLE_ROOM_BYTES:
            return f" (only {free / 1e6:.1f} MB are left on the disk of {folder})"
    return ""


def _arguments(parser: argparse.ArgumentParser, main: Callable, snakemake: Any) -> dict:
    """Collect the rule's named values for the parser's destinations and the options."""
    named = {"threads": snakemake.threads, "gpu": int(snakemake.resources.get("gpu", 0))}
    for values in (snakemake.input, snakemake.output, snakemake.params):
        named.update(values.items())
    actions = {action.dest: action for action in parser._actions if action.dest != "help"}
    missing = [name for name, action in actions.items() if action.required and name not in named]
    if missing:
        raise TypeError(f"rule {snakemake.rule} gives no {', '.join(missing)}")
    defaults = {name: action.default for name, action in actions.items()}
    defaults |= {name: option.default for name, option in options_of(main).items()}
    values = {name: named.get(name, default) for name, default in defaults.items()}
    for name, action in actions.items():  # a rule gives one file as its name
        if action.nargs == "*" and isinstance(values[name], str):
            values[name] = [values[name]]
    # Snakemake's lists of files carry state that a stage has no use for
    return {key: list(value) if isinstance(value, list) else value for key, value in values.items()}


def _bundled(main: Callable, values: dict) -> dict:
    """Put the options' values into the classes that ``main`` takes; None is an option's default."""
    held: dict[str, dict] = {}
    for name, option in options_of(main).items():
        value = values.pop(name)
        held.setdefault(option.holder, {})[name] = option.default if value is None else value
    values |= held.pop("", {})
    kinds = inspect.signature(main, eval_str=True).parameters
    return values | {name: kinds[name].annotation(**given) for name, given in held.items()}


def _redirect_output(log_path: str, prefix: str) -> TextIO:
    """Send both streams, native writes included, to the log; return the old console."""
    Path(log_path).parent.mkdir(parents=True, exist_ok=True)
    console = os.fdopen(os.dup(2), "w", encoding="utf-8", errors="replace")
    log_fd = os.open(log_path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o644)
    sys.stdout.flush()
    sys.stderr.flush()
    os.dup2(log_fd, 1)
    os.dup2(log_fd, 2)
    os.close(log_fd)
    faulthandler.enable()
    to_log = logging.StreamHandler(sys.stderr)
    to_log.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    to_console = logging.StreamHandler(console)
    to_console.setFormatter(logging.Formatter(f"{prefix} %(message)s"))
    to_console.addFilter(
        lambda record: (
            getattr(record, "console", False)
            or (record.name.startswith("cherrypicker") and record.levelno == logging.WARNING)
        )
    )
    root = logging.getLogger()
    root.handlers = [to_log, to_console]
    root.setLevel(logging.INFO)
    logging.captureWarnings(True)
    return console
