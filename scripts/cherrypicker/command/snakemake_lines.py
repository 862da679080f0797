"""What Snakemake's lines tell of a run: which job started, ended or failed, how many there are."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

# The line after which Snakemake tells of jobs; before it stand its version, the DAG and the table
FIRST_JOBS = "Select jobs to execute..."
LAST_JOBS = ("Exiting because", "Complete log(s):", "Will exit after finishing")
_TREE = r"[\w.\-]+"
_LINES = {
    "cores": r"Provided cores: (?P<n_all>\d+)",
    "started": rf"(?:local)?[Jj]ob (?P<job>\d+): (?:(?P<tree>{_TREE}): )?(?P<text>.*)",
    "finished": r"Finished jobid: (?P<job>\d+) \(Rule: (?P<rule>\w+)\)",
    "steps": r"(?P<n_done>\d+) of (?P<n_all>\d+) steps \(",
    "failed": r"ERROR \w+=(?P<tree>\S+)(?: \w+=\S+)* rule=(?P<rule>\w+): (?P<text>.*)",
    "error": r"Error in (?:rule|group) (?P<rule>[\w-]+)",
    "broken": r" +jobid: (?P<job>\d+)",
    "detail": rf"\[(?:(?P<tree>{_TREE}) (?:{_TREE} )*)?(?P<rule>\w+)\] (?P<text>.*)",
}
_PATTERNS = {kind: re.compile(pattern) for kind, pattern in _LINES.items()}
_TABLE_HEAD = "Job stats"
_TABLE_ROW = re.compile(r"(?P<rule>\w+) +(?P<n_all>\d+)$")
_TABLE_SUM = "total"


@dataclass
class Event:
    """What one line tells.

    Attributes
    ----------
    kind : str
        ``counts`` (a row of the table of jobs), ``cores``, ``started``, ``finished``, ``steps``,
        ``failed`` (a stage's own line), ``error`` with ``broken`` after it (a job that failed, for
        whatever cause), ``detail`` (a stage's progress or warning) or ``other``.
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
    in_table, broken_rule = False, ""
    for line in (line.rstrip("\n") for line in lines):
        in_table = line.startswith(_TABLE_HEAD) or (in_table and bool(line.strip()))
        if in_table:
            found = _TABLE_ROW.match(line)
            is_row = found is not None and found["rule"] != _TABLE_SUM
            event = _event("counts", line, found) if found and is_row else Event("other", line)
        else:
            matches = ((kind, pattern.match(line)) for kind, pattern in _PATTERNS.items())
            told = next(((kind, found) for kind, found in matches if found), None)
            event = _event(told[0], line, told[1]) if told else Event("other", line)
        if event.kind == "error":
            broken_rule = event.rule
        elif event.kind == "broken":
            # only after an error: every started job has a line of its number as well
            event.kind = "broken" if broken_rule else "other"
            event.rule, broken_rule = broken_rule, ""
        yield event


def _event(kind: str, line: str, found: re.Match) -> Event:
    told = {name: value or "" for name, value in found.groupdict().items()}
    return Event(
        kind,
        line,
        job=int(told.get("job", -1)),
        tree=told.get("tree", ""),
        rule=told.get("rule", ""),
        text=told.get("text", ""),
        n_done=int(told.get("n_done", 0)),
        n_all=int(told.get("n_all", 0)),
    )
