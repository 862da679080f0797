"""What jobs took, as Snakemake's benchmark files tell: time, CPU time and memory."""

import logging
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from cherrypicker.errors import StageError
from cherrypicker.files import cell_number, read_table

logger = logging.getLogger(__name__)

_COLUMNS = ("s", "cpu_time", "max_rss")


class Benchmark(NamedTuple):
    """One job."""

    wall_s: float
    cpu_s: float  # of all its threads; samples, up to 30 s apart
    memory_mb: float  # largest resident set that was sampled


def read_benchmark(path: Path) -> Benchmark | None:
    """Read the last row of a benchmark file; None if it holds no numbers, which is logged."""
    try:
        line, row = read_table(path, _COLUMNS, "\t")[-1]
        return Benchmark(*(cell_number(row[name], path, line) for name in _COLUMNS))
    except StageError as error:
        logger.warning("%s is left out: %s", path, error.cause)
        return None


def read_benchmarks(trees: Collection[str]) -> dict[str, dict[str, Benchmark]]:
    """Return the jobs of each stage that was run for these trees, by stage and tree."""
    found: dict[str, dict[str, Benchmark]] = {}
    for path in sorted(Path("benchmarks").glob("*/*.tsv")):
        if path.stem in trees and (job := read_benchmark(path)):
            found.setdefault(path.parent.name, {})[path.stem] = job
    return found
