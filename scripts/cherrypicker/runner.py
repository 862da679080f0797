"""Run a stage's ``main`` from Snakemake or from the command line, with one way to log and to fail.

Under Snakemake the rule's named inputs, outputs and params are the keyword arguments of ``main``.
The rule's log takes everything, native output of COLMAP and Open3D too; the console gets progress,
warnings and, when the stage fails, one line. A status file below ``logs/status`` tells the batch
summary which stage of which tree failed, and why; one that still says "running" after the run was
killed.
"""

from __future__ import annotations

import argparse
import errno
import faulthandler
import logging
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from cherrypicker.errors import StageError
from cherrypicker.files import write_json

logger = logging.getLogger(__name__)

STATUS_DIR = Path("logs/status")
NO_TREE = "_batch"
_LITTLE_ROOM_BYTES = 500_000_000
_DISK_ERRORS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EROFS: "the folder is read-only",
    errno.EACCES: "no permission",
    errno.EPERM: "no permission",
}


def stage_parser(doc: str) -> argparse.ArgumentParser:
    """Return the argument parser of a stage script from its module docstring."""
    return argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def run(main: Callable, parser: argparse.ArgumentParser, snakemake: object | None = None) -> None:
    """Call ``main`` with the arguments of the rule, or of the command line.

    Does nothing when the script is imported rather than run.

    Parameters
    ----------
    main : callable
        Takes the parser's destinations as keyword arguments.
    parser : argparse.ArgumentParser
        Its destinations bear the names of the rule's inputs, outputs and params; ``threads`` and
        ``gpu`` take the rule's threads and GPU resource.
    snakemake : object, optional
        Snakemake's script object; None on the command line.

    Raises
    ------
    SystemExit
        With code 1 when the stage fails; the reason has been printed on one line.
    """
    if main.__module__ != "__main__":
        return
    if snakemake is None:
        _run_from_command_line(main, parser)
    else:
        _run_from_rule(main, parser, snakemake)


def _run_from_command_line(main: Callable, parser: argparse.ArgumentParser) -> None:
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    try:
        main(**vars(parser.parse_args()))
    except (StageError, OSError) as error:
        logger.error("error: %s", StageError(**_explain(error)).describe())
        raise SystemExit(1) from None


def _run_from_rule(main: Callable, parser: argparse.ArgumentParser, snakemake) -> None:
    rule = snakemake.rule
    tree = snakemake.wildcards.get("tree", NO_TREE)
    log_path = str(snakemake.log[0]) if len(snakemake.log) else os.devnull
    console = _redirect_output(log_path, f"[{tree} {rule}]" if tree != NO_TREE else f"[{rule}]")
    status = STATUS_DIR / tree / f"{rule}.json"
    record = {"state": "running", "rule": rule, "tree": tree, "log": log_path, "time": _now()}
    try:
        write_json(status, record)
        _refuse_bad_row(snakemake.params)
        main(**_arguments(parser, snakemake))
    except Exception as error:
        logger.exception("the stage failed")
        failure = _explain(error, snakemake.output)
    else:
        status.unlink(missing_ok=True)
        return
    line = StageError(**failure).describe()
    # The console first: on a full disk it is all that is left to tell the reason.
    console.write(f"ERROR tree={tree} rule={rule}: {line}; log: {log_path}\n")
    console.flush()
    try:
        write_json(status, record | failure | {"state": "failed", "time": _now()})
    except OSError as error:
        console.write(f"ERROR tree={tree} rule={rule}: cannot note the failure ({error})\n")
        console.flush()
    raise SystemExit(1)


def _refuse_bad_row(params) -> None:
    """Raise what the Snakefile found wrong with the tree's row, before any work is done for it."""
    problem = dict(params.items()).get("problem")
    if problem:
        raise StageError(**problem)


def _explain(error: Exception, outputs: Iterable[str] = ()) -> dict:
    """Return cause, file and key of a failure as a user reads them."""
    if isinstance(error, StageError):
        return {"cause": error.cause, "file": error.file, "key": error.key}
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


def _arguments(parser: argparse.ArgumentParser, snakemake) -> dict:
    """Collect the rule's named values for the parser's destinations."""
    named = {"threads": snakemake.threads, "gpu": int(snakemake.resources.get("gpu", 0))}
    for values in (snakemake.input, snakemake.output, snakemake.params):
        named.update(values.items())
    arguments, missing = {}, []
    for action in parser._actions:
        if action.dest in named:
            value = named[action.dest]
            # Snakemake's lists of files carry state that a stage has no use for
            arguments[action.dest] = list(value) if isinstance(value, list) else value
        elif action.required:
            missing.append(action.dest)
        elif action.dest != "help":
            arguments[action.dest] = action.default
    if missing:
        raise TypeError(f"rule {snakemake.rule} gives no {', '.join(missing)}")
    return arguments


def _redirect_output(log_path: str, prefix: str):
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
    to_console.addFilter(_is_for_console)
    root = logging.getLogger()
    root.handlers = [to_log, to_console]
    root.setLevel(logging.INFO)
    logging.captureWarnings(True)
    return console


def _is_for_console(record: logging.LogRecord) -> bool:
    if getattr(record, "console", False):
        return True
    return record.name.startswith("cherrypicker") and record.levelno == logging.WARNING


def _now() -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")
