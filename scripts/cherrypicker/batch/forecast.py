"""What a batch will cost before anything is run: CPU hours, memory, disk and least time."""

import statistics
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from cherrypicker.batch.benchmarks import read_benchmarks
from cherrypicker.batch.resources import MEMORY_MARGIN, STAGES, ScanSize, mb_to_ask, threads_to_ask
from cherrypicker.progress import duration

# Benchmarks of a stage from which on they count for more than the shipped rates
ENOUGH_BENCHMARKS = 3
# Below this Snakemake's samples of a stage's CPU time, up to 30 s apart, say too little
_LEAST_CPU_S = 5.0


class Correction(NamedTuple):
    """How a folder's own benchmarks differ from the shipped rates, for one stage."""

    # cpu, memory: factors on CPU time and on memory
    cpu: float = 1.0
    memory: float = 1.0
    n_benchmarks: int = 0  # benchmark files behind them


class Job(NamedTuple):
    """One stage of one scan."""

    scan: str
    rule: str
    threads: int
    cpu_s: float
    memory_gb: float  # that it asks for
    disk_gb: float
    n_benchmarks: int  # benchmark files that corrected the rates

    @property
    def seconds(self) -> float:
        """Running time with its threads."""
        return self.cpu_s / self.threads


def forecast_jobs(
    scans: Mapping[str, ScanSize],
    corrections: Mapping[str, Correction] | None = None,
    cores: int | None = None,
) -> list[Job]:
    """Return the cost of every stage of every scan, by its id, with `cores` threads at most."""
    jobs = []
    for name, scan in scans.items():
        for rule in scan.stages:
            fix = (corrections or {}).get(rule, Correction())
            threads = min(threads_to_ask(rule, scan), cores or scan.cost(rule).max_threads)
            memory_gb = fix.memory * mb_to_ask(rule, scan, threads) / 1000.0
            cpu_s, disk_gb = fix.cpu * scan.cpu_s(rule), scan.disk_mb(rule) / 1000.0
            jobs.append(Job(name, rule, threads, cpu_s, memory_gb, disk_gb, fix.n_benchmarks))
    return jobs


def least_hours(jobs: Sequence[Job], cores: int) -> float:
    """Return the hours that so many cores need at least: all of them busy, or the longest tree."""
    of_tree = dict.fromkeys((job.scan for job in jobs), 0.0)
    for job in jobs:
        of_tree[job.scan] += job.seconds
    held_s = sum(job.threads * job.seconds for job in jobs)
    return max([held_s / cores, *of_tree.values()]) / 3600.0


def read_corrections(scans: Mapping[str, ScanSize]) -> dict[str, Correction]:
    """Compare the benchmark files of earlier runs with the shipped rates, stage by stage.

    A stage counts from :data:`ENOUGH_BENCHMARKS` files on. Its CPU factor is the median over the
    scans, since a stage that resumed half-made work took less than it should; its memory factor is
    the largest, never below one, since the files hold samples and miss peaks. Files of other scans
    than these, by id, are left out.
    """
    corrections = {}
    for rule, jobs in read_benchmarks(scans.keys()).items():
        cpu, memory = [], [MEMORY_MARGIN]
        for name, job in jobs.items():
            scan = scans[name]
            if rule in scan.stages:
                expected_s = max(scan.cpu_s(rule), _LEAST_CPU_S)
                cpu.append(max(job.cpu_s, _LEAST_CPU_S) / expected_s)
                memory.append(job.memory_mb / scan.memory_mb(rule))
        if len(cpu) >= ENOUGH_BENCHMARKS:
            factor = max(memory) / MEMORY_MARGIN
            corrections[rule] = Correction(statistics.median(cpu), factor, len(cpu))
    return corrections


def forecast_text(jobs: Sequence[Job], cores: int) -> str:
    """Return the forecast as a table to read, with the hours that so many cores need at least."""

    def line(name: str, some: Sequence[Job], threads: object = "", minutes: str = "") -> str:
        return (
            f"{name:20s}{len(some):6d}{threads:>9}{sum(job.cpu_s for job in some) / 3600.0:9.2f}"
            f"{minutes:>11s}{max((job.memory_gb for job in some), default=0.0):10.1f}"
            f"{sum(job.disk_gb for job in some):9.1f}"
        )

    lines = [
        f"{len({job.scan for job in jobs})} scans",
        f"{'stage':20s}{'jobs':>6s}{'threads':>9s}{'CPU h':>9s}{'min a job':>11s}"
        f"{'GB a job':>10s}{'disk GB':>9s}  rates",
    ]
    for rule in STAGES:
        if of_rule := [job for job in jobs if job.rule == rule]:
            minutes = f"{max(job.seconds for job in of_rule) / 60.0:.1f}"
            found = of_rule[0].n_benchmarks
            rates = f"{found} benchmarks here" if found else "shipped"
            threads = max(job.threads for job in of_rule)
            lines.append(f"{line(rule, of_rule, threads, minutes)}  {rates}")
    lines.append(line("all", jobs))
    lines.append(f"{cores} cores: at least {duration(3600.0 * least_hours(jobs, cores))}")
    return "\n".join(lines)


def formula_table() -> str:
    """Return the formulas behind the forecast and the jobs' requests as a Markdown table."""
    lines = [
        "| stage | CPU, s | memory, MB | memory a thread, MB | disk, MB | threads |",
        "|---|---|---|---|---|---|",
    ]
    for rule in STAGES:
        stage = ScanSize().cost(rule)
        cells = " | ".join((stage.cpu_s, stage.memory_mb, stage.thread_memory_mb, stage.disk_mb))
        lines.append(f"| {rule} | {cells} | {stage.max_threads} |")
    return "\n".join(lines)
