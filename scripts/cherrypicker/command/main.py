"""Entry of the command `cherrypicker`: find the subcommand, read its arguments, tell its errors."""

import importlib
import logging
import os
import sys
from collections.abc import Sequence

from cherrypicker.errors import StageError

SUBCOMMANDS = {
    "init": "make a work folder: a commented table and config, photos found by sub-folder",
    "check": "look at table and photos before the run: go, or what to photograph again",
    "run": "run the batch with Snakemake, with progress and time left",
    "serve": "serve the pages on this machine alone, so that edits are saved by clicking",
    "view": "open a tree's page, or the batch's, in the browser",
    "repeat": "tell how well two scans of one tree agree, and what a trial needs",
    "measures": "make hand measurements of a tree that was digitised node by node",
    "export": "write finished trees in the formats of other tools",
    "doctor": "tell versions, libraries, GPU, disk and memory, and what to install",
}


def usage() -> str:
    """Return the list of subcommands."""
    lines = [f"  {name:9s}{text}" for name, text in SUBCOMMANDS.items()]
    lines = ["usage: cherrypicker COMMAND ...", "", *lines, ""]
    return "\n".join([*lines, "cherrypicker COMMAND --help tells more; see docs/command.md"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a subcommand, by default that of the process's arguments; return the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or given[0] in ("-h", "--help", "help"):
        print(usage())
        return 0
    name, *rest = given
    if name not in SUBCOMMANDS:
        print(f"error: there is no command {name!r}\n\n{usage()}", file=sys.stderr)
        return 2
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    module = importlib.import_module(f"cherrypicker.command.{name}")
    module.parser.prog = f"cherrypicker {name}"
    args, others = module.parser.parse_known_intermixed_args(rest)
    if "others" in args:  # handed on
        args.others = others
    elif others:
        module.parser.error(f"unrecognized arguments: {' '.join(others)}")
    try:
        if "directory" in args:  # all paths of table and config start there
            try:
                os.chdir(args.directory)
            except OSError as error:
                cause = f"no work folder here ({error.strerror})"
                raise StageError(cause, file=args.directory) from error
        return module.main(args)
    except StageError as error:
        print(f"error: {error.describe()}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
