"""Snakemake in processes that are forked from one that has loaded it: loading takes seconds.

What runs is ``snakemake``'s own entry point, in a process of its own, with arguments, folder and
environment of its own; all that it starts is started anew.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from pathlib import Path

_FORKED = multiprocessing.get_context("forkserver")
_FORKED.set_forkserver_preload(["snakemake.cli", "smart_open"])


def _become_snakemake(
    arguments: list[str], folder: Path, environment: dict[str, str], printed: Path
) -> None:
    """Run Snakemake in this process, which prints to a file."""
    stream = os.open(printed, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(stream, sys.__stdout__.fileno())
    os.dup2(stream, sys.__stderr__.fileno())
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["snakemake", *arguments]
    from snakemake.cli import main

    main()


def run_snakemake(
    arguments: list[str],
    folder: Path,
    environment: dict[str, str],
    printed: Path,
    limit_s: float,
) -> int:
    """Run Snakemake in a folder, printing to a file; return its exit code.

    Raises
    ------
    TimeoutError
        If it has not ended after ``limit_s`` seconds; it is killed then.
    """
    process = _FORKED.Process(
        target=_become_snakemake, args=(arguments, folder, environment, printed)
    )
    process.start()
    process.join(limit_s)
    if process.exitcode is None:
        process.kill()
        process.join()
        raise TimeoutError(f"snakemake {' '.join(arguments)}: {limit_s} s are over")
    return process.exitcode
