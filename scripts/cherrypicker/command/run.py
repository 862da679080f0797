"""Run the batch of a work folder with Snakemake, with progress and time left.

All further options go to Snakemake as they are; the command that is run is printed, and can be
called by hand. Snakemake's own output is in the log that is named at the end; with --plain it is
shown instead. Examples:

    cherrypicker run
    cherrypicker run -d WORK --cores 4 results/row3_tree07/report.html
    cherrypicker run --dry-run
    cherrypicker run --workflow-profile PROJECT/profiles/slurm
"""

import argparse
import csv
import json
import logging
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn
from rich.table import Table

import snakemake_logger_plugin_cherrypicker
from cherrypicker.batch.config import CONFIG_FILE, read_config_file
from cherrypicker.command.time_left import TimeLeft, seconds_of_stages
from cherrypicker.command.work_folder import batch_here, folder_parser
from cherrypicker.errors import StageError
from cherrypicker.files import PROJECT, read_json, written_at
from cherrypicker.progress import duration
from cherrypicker.runner import failure_told, status_file, status_folder, told_of
from snakemake_logger_plugin_cherrypicker import SEPARATOR

TRAITS_TABLE = Path("results/traits.csv")
LOGS = Path(".snakemake/log")
SHOWN = ("tree", "status", "height_m", "trunk_diameter_m", "total_length_m", "n_tips")

parser = folder_parser(__doc__)
parser.add_argument("--plain", action="store_true", help="show Snakemake's own output")
parser.set_defaults(others=[])  # options of Snakemake's


def main(args: argparse.Namespace) -> int:
    """Run Snakemake; return its exit status."""
    if Path(CONFIG_FILE).is_file():  # Snakemake would refuse it without a word of which file it is
        read_config_file(may_be_empty=False)
    snakefile = str(PROJECT / "Snakefile")
    command = [sys.executable, "-m", "snakemake", "--snakefile", snakefile]
    command += ["--directory", os.getcwd(), *args.others]
    width = None if sys.stdout.isatty() else sys.maxsize  # a file's lines end where they like
    console = Console(soft_wrap=True, highlight=False, markup=False, width=width)
    console.print(f"running: {shlex.join(command)}")
    if args.plain:
        return subprocess.run(command, check=False).returncode
    plugins = Path(snakemake_logger_plugin_cherrypicker.__file__).parents[1]
    path = os.pathsep.join(filter(None, [str(plugins), os.environ.get("PYTHONPATH")]))
    try:
        seconds = seconds_of_stages(batch_here())
    except (StageError, OSError):  # Snakemake's options may name another table or config
        seconds = {}
    view, table_before = _View(console, TimeLeft(seconds)), written_at(TRAITS_TABLE)
    # An interrupt reaches Snakemake as well, which then ends in its own time
    on_interrupt = signal.signal(signal.SIGINT, lambda *_: None)
    with subprocess.Popen(
        [*command, "--logger", "cherrypicker"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env=os.environ | {"PYTHONPATH": path},
    ) as process:
        assert process.stdout is not None
        with view.progress:
            for line in process.stdout:
                view.take(line.rstrip("\n"))
    signal.signal(signal.SIGINT, on_interrupt)
    if not view.has_run:
        console.print("\n".join(view.head))
    else:
        log = max(LOGS.glob("*.log"), default=LOGS)
        console.print(f"Snakemake's own log: {log.absolute()}")
        # A run for some files alone does not write it
        if written_at(TRAITS_TABLE) not in (0, table_before):
            console.print(closing_table(TRAITS_TABLE))
            console.print(f"pages: {Path('results/summary.html').resolve()}")
    return process.returncode


@dataclass
class _Job:
    """A job that runs."""

    rule: str
    name: str  # for the reader
    wildcards: dict[str, str]
    log: list[str]
    start: float  # seconds since the epoch
    task: TaskID
    last_words: str = ""

    @property
    def whose(self) -> str:
        """The tree, or what else it is of, and the rule, as the stages' runner tells them."""
        return " ".join([*self.wildcards.values(), self.rule])

    def cause(self, notes_before: Mapping[Path, int]) -> str:
        """Why it failed: what the stage noted, else what it said last (on a full disk)."""
        note = status_file(self.rule, self.wildcards)
        with suppress(OSError, StageError):
            told = read_json(note)
            if told["state"] == "failed" and written_at(note) != notes_before.get(note, 0):
                return failure_told(told)
        log = f"; log: {self.log[0]}" if self.log else ""
        return self.last_words or f"it ended without a word (killed, or out of memory?){log}"


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
        self._jobs: dict[int, _Job] = {}
        self._failed: set[int] = set()
        self._early: list[str] = []  # what jobs said before Snakemake told of them
        self._notes = {path: written_at(path) for path in status_folder().parent.glob("*/*.json")}
        self.head: list[str] = []  # what Snakemake says beside the jobs
        self._last = ""

    def take(self, line: str) -> None:
        """Show what a line tells: a record of the logger plugin, or a job's own line."""
        if not line.startswith(SEPARATOR):
            # Snakemake tells of its jobs from a thread of its own, so that a short one may be first
            is_told = any(self._show_if_of(job, line) for job in self._jobs.values())
            if not is_told and line.startswith(("[", "ERROR ")):
                self._early.append(line)
            return
        told = json.loads(line[len(SEPARATOR) :])
        match told["event"]:
            case "run_info":
                stats = (told["stats"] or {}).items()
                self.time_left.waiting.update({rule: n for rule, n in stats if rule != "total"})
            case "resources_info":
                self.time_left.cores = told["cores"] or self.time_left.cores
            case "job_started":
                self.has_run = True
            case "job_info":
                name = told["rule_msg"] or told["rule_name"]
                if told["jobid"] in self._failed:
                    self.console.print(f"again: {name}")
                task = self.progress.add_task(name, total=None, said="")
                begun = _Job(
                    told["rule_name"], name, told["wildcards"], told["log"], time.time(), task
                )
                self._jobs[told["jobid"]] = begun
                self._early = [line for line in self._early if not self._show_if_of(begun, line)]
            case "job_finished" if job := self._end(told["job_id"]):
                self.time_left.finish(job.rule)
                self._last = f"{job.name}, {duration(time.time() - job.start)}"
            case "job_error" if job := self._end(told["jobid"]):
                self.time_left.fail(job.rule)
                self._failed.add(told["jobid"])
                self.console.print(f"FAILED {job.whose}: {job.cause(self._notes)}")
            case "progress":
                done, total = told["done"], told["total"]
                left = f"about {duration(self.time_left.left_s())} left"
                steps = f"{done} of {total}, {left}"
                self.progress.update(self._all, total=total, completed=done, said=steps)
                self.console.print(f"[{done}/{total}] {self._last}; {left}")
        is_job = self.has_run and told.get("exception") == "RuleException"  # told as its failure
        if not told.get("text") or is_job:
            return
        if told["event"] in ("", "error") and told["level"] >= logging.WARNING:
            self.console.print(told["text"])
        else:
            self.head.append(told["text"])

    def _end(self, number: int) -> _Job | None:
        job = self._jobs.pop(number, None)
        if job:
            self.progress.remove_task(job.task)
        return job

    def _show_if_of(self, job: _Job, line: str) -> bool:
        """Show a line that a job has said; whether it has."""
        _, is_error, words = line.partition(f"rule={job.rule}: ")
        if line.startswith(f"[{job.whose}] "):
            self.progress.update(job.task, said=line.partition("] ")[2])
            if not self.console.is_terminal:
                self.console.print(line)
        elif is_error and line.startswith(f"ERROR {told_of(job.wildcards)} "):
            job.last_words = words
        else:
            return False
        return True


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
