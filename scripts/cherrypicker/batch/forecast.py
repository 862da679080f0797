"""What a batch will cost before anything is run: CPU hours, memory, disk and least time."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cherrypicker.batch.benchmarks import read_benchmarks
from cherrypicker.batch.resources import (
    MEMORY_MARGIN,
    ScanSize,
    cpu_seconds,
    disk_mb,
    mb_to_ask,
    memory_mb,
    speedup,
    threads_to_ask,
)
from cherrypicker.batch.stage_costs import stages_of
from cherrypicker.mvs.backends.table import first_choice
from cherrypicker.progress import duration

# Benchmarks of a stage from which on they count for more than the shipped rates
ENOUGH_BENCHMARKS = 3
# Below this Snakemake's samples of a stage's CPU time, up to 30 s apart, say too little
_LEAST_CPU_S = 5.0


@dataclass(frozen=True)
class Correction:
    """How a folder's own benchmarks differ from the shipped rates, for one stage."""

    # cpu, memory: factors on CPU time and on memory
    cpu: float = 1.0
    memory: float = 1.0
    n_benchmarks: int = 0  # benchmark files behind them


@dataclass(frozen=True)
class StageForecast:
    """One stage over all scans."""

    rule: str
    n_jobs: int
    max_threads: int  # of the widest job
    cpu_hours: float  # of all jobs
    job_minutes: float  # running time with its threads of the longest job
    memory_gb: float  # asked for by the largest
    disk_gb: float  # of all jobs
    n_benchmarks: int  # benchmark files that corrected the rates


def _costs(
    scans: Mapping[str, ScanSize],
    labelled: Sequence[str],
    corrections: Mapping[str, Correction],
    cores: int | None,
) -> Iterator[tuple[str, str, int, float, float]]:
    """Yield scan, stage, threads, CPU seconds and memory in GB of every job, scan by scan."""
    for name, scan in scans.items():
        for rule, stage in scan.stages.items():
            if rule == "segment_cloud" and name in labelled:
                continue  # labels need no network
            fix = corrections.get(rule, Correction())
            threads = threads_to_ask(rule, scan)
            threads = min(threads, cores) if cores else threads
            memory_gb = fix.memory * mb_to_ask(rule, scan, threads) / 1000.0
            yield name, rule, threads, fix.cpu * cpu_seconds(stage, scan), memory_gb


def forecast_stages(
    scans: Mapping[str, ScanSize],
    labelled: Sequence[str] = (),
    corrections: Mapping[str, Correction] | None = None,
    cores: int | None = None,
) -> list[StageForecast]:
    """Return the cost of every stage over all scans, in the order in which they run.

    Parameters
    ----------
    scans : mapping
        Size of each scan by its id.
    labelled : sequence of str
        Ids of ready clouds with labels.
    corrections : mapping, optional
        From :func:`read_corrections`, by stage.
    cores : int, optional
        Most threads of a job.
    """
    corrections = corrections or {}
    rows: dict[str, list] = {}
    for name, rule, threads, cpu_s, memory_gb in _costs(scans, labelled, corrections, cores):
        row = rows.setdefault(rule, [0, 0, 0.0, 0.0, 0.0, 0.0])
        row[0] += 1
        row[1] = max(row[1], threads)
        row[2] += cpu_s / 3600.0
        row[3] = max(row[3], cpu_s / speedup(threads) / 60.0)
        row[4] = max(row[4], memory_gb)
        row[5] += disk_mb(scans[name].stages[rule], scans[name]) / 1000.0
    return [
        StageForecast(rule, *row, corrections.get(rule, Correction()).n_benchmarks)  # type: ignore[call-arg]
        for rule, row in rows.items()
    ]


def least_hours(
    scans: Mapping[str, ScanSize],
    labelled: Sequence[str] = (),
    corrections: Mapping[str, Correction] | None = None,
    cores: int = 1,
) -> float:
    """Return the hours that so many cores need at least: all of them busy, or the longest tree."""
    held_s, of_tree = 0.0, dict.fromkeys(scans, 0.0)
    for name, _, threads, cpu_s, _ in _costs(scans, labelled, corrections or {}, cores):
        job_s = cpu_s / speedup(threads)
        held_s += threads * job_s
        of_tree[name] += job_s
    return max([held_s / cores, *of_tree.values()]) / 3600.0


def with_stereo(
    scans: Mapping[str, ScanSize], backends: Mapping[str, str], has_gpu: bool
) -> dict[str, ScanSize]:
    """Return the scans with depth maps on a GPU where there is one and the config allows it.

    Parameters
    ----------
    backends : mapping
        The key ``mvs.backend`` of each scan.
    """
    return {
        name: replace(scan, stereo=first_choice(backends[name], has_gpu))
        for name, scan in scans.items()
    }


def read_corrections(
    benchmarks: str | Path, scans: Mapping[str, ScanSize]
) -> dict[str, Correction]:
    """Compare a folder's benchmark files with the shipped rates, stage by stage.

    A stage counts from :data:`ENOUGH_BENCHMARKS` files on. Its CPU factor is the median over the
    scans, since a stage that resumed half-made work took less than it should; its memory factor is
    the largest, never below one, since the files hold samples and miss peaks.

    Parameters
    ----------
    benchmarks : path-like
        The folder ``benchmarks`` of earlier runs.
    scans : mapping
        Sizes of the scans that were run, by id; files of other scans are left out.
    """
    corrections = {}
    for rule, jobs in read_benchmarks(benchmarks, scans.keys()).items():
        ratios = []
        for name, job in jobs.items():
            stage = scans[name].stages.get(rule)
            if stage is not None:
                expected_s = max(cpu_seconds(stage, scans[name]), _LEAST_CPU_S)
                memory = job.memory_mb / memory_mb(stage, scans[name])
                ratios.append((max(job.cpu_s, _LEAST_CPU_S) / expected_s, memory))
        if len(ratios) >= ENOUGH_BENCHMARKS:
            corrections[rule] = Correction(
                cpu=statistics.median(cpu for cpu, _ in ratios),
                memory=max(1.0, max(memory for _, memory in ratios) / MEMORY_MARGIN),
                n_benchmarks=len(ratios),
            )
    return corrections


def forecast_text(stages: Sequence[StageForecast], n_scans: int, hours: float, cores: int) -> str:
    """Return the forecast as a table to read, with the hours that so many cores need at least."""
    lines = [
        f"{n_scans} scans",
        f"{'stage':20s}{'jobs':>6s}{'threads':>9s}{'CPU h':>9s}{'min a job':>11s}"
        f"{'GB a job':>10s}{'disk GB':>9s}  rates",
    ]
    for row in stages:
        source = f"{row.n_benchmarks} benchmarks here" if row.n_benchmarks else "shipped"
        lines.append(
            f"{row.rule:20s}{row.n_jobs:6d}{row.max_threads:9d}{row.cpu_hours:9.2f}"
            f"{row.job_minutes:11.1f}{row.memory_gb:10.1f}{row.disk_gb:9.1f}  {source}"
        )
    lines.append(
        f"{'all':20s}{sum(row.n_jobs for row in stages):6d}{'':9s}"
        f"{sum(row.cpu_hours for row in stages):9.2f}{'':11s}"
        f"{max((row.memory_gb for row in stages), default=0.0):10.1f}"
        f"{sum(row.disk_gb for row in stages):9.1f}"
    )
    lines.append(f"{cores} cores: at least {duration(3600.0 * hours)}")
    return "\n".join(lines)


def formula_table() -> str:
    """Return the formulas behind the forecast and the jobs' requests as a Markdown table."""
    lines = [
        "| stage | CPU, s | memory, MB | memory a thread, MB | disk, MB | threads |",
        "|---|---|---|---|---|---|",
    ]
    for rule, stage in stages_of("", "photos", "clouds").items():
        cells = " | ".join((stage.cpu_s, stage.memory_mb, stage.thread_memory_mb, stage.disk_mb))
        lines.append(f"| {rule} | {cells} | {stage.max_threads} |")
    return "\n".join(lines)
