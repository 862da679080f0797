"""A series of which some scans failed: the others are compared all the same.

Snakemake starts no job whose inputs are missing. Called by its ``onerror`` handler inside the main
process, so the comparison, which is heavy, runs in a process of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

from cherrypicker.batch.summary import collect_results
from cherrypicker.batch.trees import Tree
from cherrypicker.runner import status_folder, status_name


def compare_rest(series: str, rows: list[Tree], script: str | os.PathLike) -> None:
    """Compare the finished scans of a series, if there are two, where others are not finished.

    Parameters
    ----------
    series : str
        Name of its folder.
    rows : list of Tree
    script : path-like
        ``compare_series.py``.
    """
    found = collect_results([asdict(row) for row in rows], "results", "logs")
    done = [row for row, result in zip(rows, found, strict=True) if result.traits]
    rest = [row.tree for row in rows if row not in done]
    if len(done) < 2 or not rest:
        return
    log = Path("logs/compare_series") / f"{series}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    arguments = ["--series", rows[0].series, "--folder", f"results/series/{series}"]
    arguments += ["--trees", *(row.tree for row in done)]
    arguments += ["--dates", *(row.date for row in done), "--unfinished", *rest]
    with open(log, "w", encoding="utf-8") as stream:
        command = [sys.executable, os.fspath(script), *arguments]
        code = subprocess.run(command, stdout=stream, stderr=stream, check=False).returncode
    # The rule has not run: it shall when the rest is finished, or no longer in the table
    for path in Path(f"results/series/{series}").glob("*"):
        os.utime(path, (0, 0))
    if not code:  # an earlier failure of the rule is no more the last word
        (status_folder() / status_name("compare_series", [series])).unlink(missing_ok=True)
    end = f"failed; log: {log}" if code else "are compared"
    print(f"series {series}: {', '.join(rest)} not finished, the others {end}", file=sys.stderr)
