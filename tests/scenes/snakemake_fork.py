"""Snakemake and its stages in forks of a process that has loaded them: loading takes seconds.

What runs is ``snakemake``'s own entry point, in a process of its own, with arguments, folder and
environment of its own; so does the one that it starts after a failure. A stage's script, as
Snakemake wrote it, runs in a fork of that one, which has the packages but nothing of the project.
Tests of clusters and of the command line start all anew, as a user does.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
import time
import traceback
from contextlib import suppress
from functools import cache
from multiprocessing import forkserver
from pathlib import Path
from typing import Any, NoReturn
from unittest.mock import patch

FORKED = multiprocessing.get_context("forkserver")
FORKED.set_forkserver_preload(["stage_packages"])
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def _run_script(path: str, threads: int) -> NoReturn:
    """Run a stage's script in this process, which was forked for it, as Python would."""
    code: object = 1
    try:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        # Other threads of Snakemake may have held what locks its streams and loggers
        sys.stdout, sys.stderr = (os.fdopen(fd, "w", buffering=1, closefd=False) for fd in (1, 2))
        logging.root.handlers.clear()
        os.environ.update(dict.fromkeys(_THREADS, str(threads)))
        for name in [each for each in sys.modules if each.partition(".")[0] == "cherrypicker"]:
            del sys.modules[name]
        # Nothing of the tests' search path, nor of the Snakefile's: the script finds its own
        installed = [each for each in sys.path if each.startswith((sys.prefix, sys.base_prefix))]
        sys.argv, sys.path[:] = [path], [os.path.dirname(path), *installed]
        runpy.run_path(path, run_name="__main__")
        code = 0
    except SystemExit as error:
        code = error.code or 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code if isinstance(code, int) else 1)


def _become_snakemake(
    arguments: list[str], folder: Path, environment: dict[str, str], printed: Path
) -> None:
    """Run Snakemake in this process, the first of a group of its own, which prints to a file."""
    os.setsid()
    stream = os.open(printed, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(stream, sys.__stdout__.fileno())
    os.dup2(stream, sys.__stderr__.fileno())
    os.chdir(folder)
    _snakemake(*_after_a_failure() or (arguments, environment))


def _after_a_failure() -> tuple[list[str], dict[str, str]] | None:
    """Fork a process for the Snakemake that this one starts over what is finished, if it does.

    Returns
    -------
    tuple or None
        In that process its arguments and environment, once it is to start; None in this one.
    """
    asked, ask = multiprocessing.Pipe(duplex=False)
    spare = os.fork()
    if not spare:
        ask.close()
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            folder, arguments, environment = asked.recv()
        except EOFError:  # it has ended without
            os._exit(0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.chdir(folder)
        return arguments, environment

    run_anew = subprocess.run

    def run(command: list[str], **options: Any) -> subprocess.CompletedProcess:
        if command[:3] != [sys.executable, "-m", "snakemake"]:
            return run_anew(command, **options)
        ask.send((os.getcwd(), command[3:], options["env"]))
        status = os.waitpid(spare, 0)[1]
        return subprocess.CompletedProcess(command, os.waitstatus_to_exitcode(status))

    subprocess.run = run
    return None


def _snakemake(arguments: list[str], environment: dict[str, str]) -> None:
    """Call Snakemake's entry point; stages run in forks."""
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["snakemake", *arguments]
    from snakemake.benchmark import benchmarked
    from snakemake.cli import main
    from snakemake.script import PythonScript

    def execute(script: PythonScript, fname: str, edit: bool = False) -> None:
        """Run a written script in a fork, timed as Snakemake times it."""
        path = os.path.abspath(fname)
        stage = os.fork()
        if not stage:
            _run_script(path, script.threads)
        with benchmarked(stage if script.bench_record else False, script.bench_record):
            status = os.waitpid(stage, 0)[1]
        if status:
            code = os.waitstatus_to_exitcode(status)
            raise subprocess.CalledProcessError(code, f"python {fname}")

    PythonScript.execute_script = execute
    main()


@cache
def start_what_is_forked() -> None:
    """Start it with this folder in its search path, where `stage_packages` lies."""
    with patch.dict(os.environ, PYTHONPATH=os.path.dirname(__file__)):
        forkserver.ensure_running()


class Run:
    """Snakemake in a folder, printing to a file, in a process and a group that are its own."""

    def __init__(
        self, arguments: list[str], folder: Path, environment: dict[str, str], printed: Path
    ):
        start_what_is_forked()
        self._process = FORKED.Process(
            target=_become_snakemake, args=(arguments, folder, environment, printed)
        )
        self._process.start()
        self.pid: int = self._process.pid or 0
        with suppress(ProcessLookupError):  # it has ended
            while os.getpgid(self.pid) != self.pid:
                time.sleep(0.001)

    def poll(self) -> int | None:
        """Return the exit code, or none while it runs."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Return the exit code when it has ended.

        Raises
        ------
        TimeoutError
            If it has not ended after ``timeout`` seconds; it is killed then.
        """
        try:
            self._process.join(timeout)
            code = self.poll()
        finally:
            if self.poll() is None:
                os.killpg(self.pid, signal.SIGKILL)
                self._process.join()
        if code is None:
            raise TimeoutError(f"snakemake: {timeout} s are over")
        return code
