"""Run the batch of a work folder with Snakemake, with progress and time left.

All further options go to Snakemake as they are; the command that is run is printed, and can be
called by hand. Snakemake's own output is in the log that is named at the end; with --plain it is
shown instead. Examples:

    cherrypicker run
    cherrypicker run -d WORK --cores 4 results/row3_tree07/report.html
    cherrypicker run --dry-run
    cherrypicker run --workflow-profile PROJECT/profiles/slurm
"""

from __future__ import annotations

import csv
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn
from rich.table import Table

from cherrypicker.command.snakemake_lines import FIRST_JOBS, LAST_JOBS, Event, read_events
from cherrypicker.command.time_left import TimeLeft, seconds_of_stages
from cherrypicker.command.work_folder import batch_here, enter, folder_parser
from cherrypicker.errors import StageError
from cherrypicker.files import PROJECT
from cherrypicker.progress import duration

TRAITS_TABLE = Path("results/traits.csv")
FILE_WIDTH = 120  # of the closing table where no terminal is
SHOWN = ("tree", "status", "height_m", "trunk_diameter_m", "total_length_m", "n_tips")

parser = folder_parser(__doc__)
parser.add_argument("--plain", action="store_true", help="show Snakemake's own output")


def main(arguments: Sequence[str]) -> int:
    """Run Snakemake; return its exit status."""
    args, options = parser.parse_known_args(arguments)
    enter(args.directory)
    command = snakemake_command(options)
    width = None if sys.stdout.isatty() else FILE_WIDTH
    console = Console(soft_wrap=True, highlight=False, markup=False, width=width)
    console.print(f"running: {shlex.join(command)}")
    if args.plain:
        return subprocess.run(command, check=False).returncode
    view = _View(console, TimeLeft(_forecast()))
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    ) as process:
        assert process.stdout is not None
        with view.progress:
            for event in read_events(_lines(process.stdout)):
                view.take(event)
    view.close()
    if view.has_run and TRAITS_TABLE.is_file():
        console.print(closing_table(TRAITS_TABLE))
        console.print(f"pages: {Path('results/summary.html').resolve()}")
    return process.returncode


def _forecast() -> dict[str, float]:
    """Seconds of the stages; none where Snakemake's options name another table or config."""
    try:
        return seconds_of_stages(batch_here())
    except (StageError, OSError):
        return {}


def snakemake_command(options: Sequence[str]) -> list[str]:
    """Return the command that runs this clone's workflow in the current folder."""
    snakefile = str(PROJECT / "Snakefile")
    folder = os.getcwd()
    return [
        *(sys.executable, "-m", "snakemake", "--snakefile", snakefile),
        *("--directory", folder, *options),
    ]


def _lines(stream: Iterable[str]) -> Iterable[str]:
    """Yield lines; an interrupt reaches Snakemake as well, which then ends in its own time."""
    lines = iter(stream)
    while True:
        try:
            yield next(lines)
        except StopIteration:
            return
        except KeyboardInterrupt:
            continue


class _View:
    """What of a run is shown: on a terminal a bar and the running jobs, elsewhere a line a job."""

    def __init__(self, console: Console, time_left: TimeLeft) -> None:
        self.console, self.time_left = console, time_left
        self.has_run = False
        self.progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            TextColumn("{task.fields[said]}"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._all = self.progress.add_task("stages", total=None, said="")
        self._head: list[str] = []
        self._tail: list[str] = []
        self._jobs: dict[int, tuple[str, str, float, TaskID]] = {}
        self._told: set[tuple[str, str]] = set()
        self._last = ""
        self._show = {
            "started": self._started,
            "finished": self._finished,
            "steps": self._steps,
            "failed": self._failed,
            "broken": self._broken,
            "detail": self._detail,
        }

    def take(self, event: Event) -> None:
        """Show what a line of Snakemake tells."""
        if event.kind == "counts":
            self.time_left.waiting[event.rule] = event.n_all
        elif event.kind == "cores":
            self.time_left.cores = event.n_all
        if event.line.startswith(FIRST_JOBS):
            self.has_run = True
        if not self.has_run:
            self._head.append(event.line)
        elif event.line.startswith(LAST_JOBS) or self._tail:
            self._tail.append(event.line)
        else:
            self._show.get(event.kind, self._other)(event)

    def close(self) -> None:
        """Show what Snakemake said where it ran nothing, else where its log is."""
        if not self.has_run:
            self.console.print("\n".join(self._head))
        for line in self._tail:
            if line.startswith("Complete log"):
                self.console.print(line)

    def _started(self, event: Event) -> None:
        name = f"{event.tree}: {event.text}" if event.tree else event.text
        task = self.progress.add_task(name, total=None, said="")
        self._jobs[event.job] = (event.tree, event.text, time.monotonic(), task)

    def _finished(self, event: Event) -> None:
        self.time_left.finish(event.rule)
        tree, text, start, task = self._jobs.pop(event.job, ("", "", time.monotonic(), None))
        if task is not None:
            self.progress.remove_task(task)
        took = duration(time.monotonic() - start)
        name = f"{tree}: {text or event.rule}" if tree else (text or event.rule)
        self._last = f"{name}, {took}"

    def _steps(self, event: Event) -> None:
        left = f"about {duration(self.time_left.left_s())} left"
        self.progress.update(
            self._all,
            total=event.n_all,
            completed=event.n_done,
            said=f"{event.n_done} of {event.n_all}, {left}",
        )
        self.console.print(f"[{event.n_done}/{event.n_all}] {self._last}; {left}")

    def _failed(self, event: Event) -> None:
        self._told.add((event.tree, event.rule))
        self.time_left.fail(event.rule)
        self.console.print(f"FAILED {event.tree} {event.rule}: {event.text}")

    def _broken(self, event: Event) -> None:
        tree, text, _, task = self._jobs.pop(event.job, ("", "", 0.0, None))
        if task is not None:
            self.progress.remove_task(task)
        if not {(tree, event.rule), ("_batch", event.rule)} & self._told:
            log = f"logs/{event.rule}/{tree}.log" if tree else f"logs/{event.rule}.log"
            self.console.print(
                f"FAILED {tree} {event.rule}: it ended without a word (killed, or out of memory?); "
                f"log: {log}"
            )

    def _detail(self, event: Event) -> None:
        for tree, _, _, task in self._jobs.values():
            if tree == event.tree:
                self.progress.update(task, said=event.text)
        if not self.console.is_terminal:
            self.console.print(event.line)

    def _other(self, event: Event) -> None:
        """Leave it to Snakemake's log."""


def closing_table(path: Path) -> Table:
    """Return the batch's table, a row a tree: what came out, or which stage failed and why."""
    with open(path, newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    names = [name for name in SHOWN if rows and name in rows[0]]
    table = Table(*(name.replace("_", " ") for name in names), "")
    for row in rows:
        cause = f"{row['failed_stage']}: {row['cause']}" if row.get("failed_stage") else ""
        table.add_row(*(row[name] for name in names), cause)
    return table
