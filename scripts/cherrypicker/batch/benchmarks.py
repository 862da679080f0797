"""What jobs took, as Snakemake's benchmark files tell: time, CPU time and memory."""

from __future__ import annotations

import csv
import logging
import math
import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Benchmark:
    """One job."""

    wall_s: float
    cpu_s: float  # of all its threads; samples, up to 30 s apart
    memory_mb: float  # largest resident set that was sampled


def read_benchmark(path: Path) -> Benchmark | None:
    """Read the last row of a benchmark file; None if it holds no numbers, which is logged."""
    try:
        with open(path, newline="", encoding="utf-8") as stream:
            row = list(csv.DictReader(stream, delimiter="\t"))[-1]
        found = Benchmark(float(row["s"]), float(row["cpu_time"]), float(row["max_rss"]))
    except (OSError, csv.Error, LookupError, TypeError, ValueError) as error:
        logger.warning("%s is left out: %s", path, error or type(error).__name__)
        return None
    is_finite = all(map(math.isfinite, (found.wall_s, found.cpu_s, found.memory_mb)))
    return found if is_finite else None


def read_benchmarks(
    folder: str | os.PathLike, trees: Collection[str]
) -> dict[str, dict[str, Benchmark]]:
    """Return the jobs of each stage that was run, by stage and tree.

    Parameters
    ----------
    folder : path-like
        ``benchmarks`` of a run; files of other trees and of jobs without a tree are left out.
    """
    found: dict[str, dict[str, Benchmark]] = {}
    for path in sorted(Path(folder).glob("*/*.tsv")):
        job = read_benchmark(path) if path.stem in trees else None
        if job is not None:
            found.setdefault(path.parent.name, {})[path.stem] = job
    return found
