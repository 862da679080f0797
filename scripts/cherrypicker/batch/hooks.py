"""What Snakemake's handlers do: before the first job, and when the last has ended, well or not."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

from cherrypicker.batch.batch import Batch
from cherrypicker.batch.series import compare_rest
from cherrypicker.batch.summary import summarise
from cherrypicker.batch.trees import Tree
from cherrypicker.batch.work_folder import check_writable
from cherrypicker.errors import StageError


def check_results(batch: Batch) -> None:
    """Refuse a work folder whose results cannot be written.

    Raises
    ------
    StageError
    """
    trees = dict.fromkeys([*batch.trees, *batch.known()])
    check_writable(["results", "logs", "benchmarks", *(f"results/{tree}" for tree in trees)])


def write_summary(batch: Batch, jobs: Iterable[Any]) -> None:
    """Write the batch's tables and page, also after failures; not where no tree was asked for.

    Parameters
    ----------
    jobs : iterable
        Of Snakemake's DAG.

    Raises
    ------
    StageError
    """
    if any(batch.scan_of(job.wildcards.get("tree") or "") in batch.trees for job in jobs):
        measured = batch.measured()
        rows = [
            {**asdict(row), "is_measured": row.tree in measured}
            for row in batch.rows_to_tell("logs")
        ]
        try:
            summarise(rows, "results", "logs", "results/traits.csv", "results/summary.html")
        except OSError as error:
            cause = f"the summary of the batch cannot be written: {error}"
            raise StageError(cause) from error


def compare_finished(
    series: Mapping[str, list[Tree]], jobs: Iterable[Any], script: str | os.PathLike
) -> None:
    """Compare the scans that are finished of each series that waits for one that is not."""
    waiting = {job.wildcards.series for job in jobs if job.rule.name == "compare_series"}
    for name in sorted(waiting):
        compare_rest(name, series[name], script)
