"""What Snakemake's lines tell of a run: which job started, ended or failed, and how many there are."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

# The line after which Snakemake tells of jobs; before it stand its version, the DAG and the table
FIRST_JOBS = "Select jobs to execute..."
LAST_JOBS = ("Exiting because", "Complete log(s):", "Will exit after finishing")
_STARTED = re.compile(r"(?:local)?[Jj]ob (\d+): (?:([\w.\-]+): )?(.*)")
_FINISHED = re.compile(r"Finished jobid: (\d+) \(Rule: (\w+)\)")
_STEPS = re.compile(r"(\d+) of (\d+) steps \(")
_COUNT = re.compile(r"(\w+) +(\d+)$")
_CORES = re.compile(r"Provided cores: (\d+)")
_BROKEN = re.compile(r"Error in (?:rule|group) ([\w-]+)")
_JOBID = re.compile(r" +jobid: (\d+)")
_REFUSED = re.compile(r"ERROR tree=(\S+) rule=(\w+): (.*)")
_DETAIL = re.compile(r"\[([\w.\-]+ )?(\w+)\] (.*)")


@dataclass
class Event:
    """What one line tells.

    Attributes
    ----------
    kind : str
        ``counts`` (a row of the table of jobs), ``cores``, ``started``, ``finished``, ``steps``,
        ``failed`` (a stage's own line), ``broken`` (a job that failed, for whatever cause),
        ``detail`` (a stage's progress or warning) or ``other``.
    line : str
        As Snakemake printed it.
    job : int
        Its number; -1 where none is told.
    tree, rule, text : str
    n_done, n_all : int
        Of ``steps``; of ``counts`` and ``cores`` the number is `n_all`.
    """

    kind: str
    line: str
    job: int = -1
    tree: str = ""
    rule: str = ""
    text: str = ""
    n_done: int = 0
    n_all: int = 0


def read_events(lines: Iterable[str]) -> Iterator[Event]:
    """Yield what each line of Snakemake's output tells.

    Parameters
    ----------
    lines : iterable of str
        Its two streams as one, in the form of Snakemake 9 without ``--quiet``.
    """
    reader = _Reader()
    for line in lines:
        yield reader.event(line.rstrip("\n"))


@dataclass
class _Reader:
    """Reads lines one after the other; two things stand over several."""

    in_table: bool = False
    broken: str = field(default="")

    def event(self, line: str) -> Event:
        if line.startswith("Job stats"):
            self.in_table = True
        elif not line.strip():
            self.in_table = False
        elif self.in_table and (found := _COUNT.match(line)) and found[1] != "total":
            return Event("counts", line, rule=found[1], n_all=int(found[2]))
        if found := _CORES.match(line):
            return Event("cores", line, n_all=int(found[1]))
        if found := _STARTED.match(line):
            return Event("started", line, int(found[1]), found[2] or "", text=found[3])
        if found := _FINISHED.match(line):
            return Event("finished", line, int(found[1]), rule=found[2])
        if found := _STEPS.match(line):
            return Event("steps", line, n_done=int(found[1]), n_all=int(found[2]))
        if found := _REFUSED.match(line):
            return Event("failed", line, tree=found[1], rule=found[2], text=found[3])
        if found := _BROKEN.match(line):
            self.broken = found[1]
        elif self.broken and (found := _JOBID.match(line)):
            rule, self.broken = self.broken, ""
            return Event("broken", line, int(found[1]), rule=rule)
        if found := _DETAIL.match(line):
            return Event(
                "detail", line, tree=(found[1] or "").strip(), rule=found[2], text=found[3]
            )
        return Event("other", line)
