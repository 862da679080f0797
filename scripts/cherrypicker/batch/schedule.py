"""How long a batch takes on given machines: its jobs laid out one after the other, as they fit."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Machine:
    """Equal machines that work on one batch."""

    name: str  # for the reader
    n_nodes: int
    cores: int  # of each machine, as its memory and GPUs
    memory_gb: float  # that jobs may use
    gpus: int = 0
    # Seconds that each job loses before it works: start of Snakemake, of Python, waiting for the
    # scheduler and for its file to be seen
    start_s: float = 5.0


@dataclass(frozen=True)
class Job:
    """One stage of one tree."""

    rule: str
    seconds: float  # with all its threads
    memory_gb: float
    threads: int = 1  # cores that it holds, as its GPUs
    gpus: int = 0
    after: tuple[int, ...] = ()  # positions of the jobs that must be done before


@dataclass
class _Node:
    cores: int
    memory_gb: float
    gpus: int

    def fits(self, job: Job) -> bool:
        return (
            job.threads <= self.cores
            and job.memory_gb <= self.memory_gb + 1e-9
            and job.gpus <= self.gpus
        )

    def take(self, job: Job, sign: int) -> None:
        self.cores -= sign * job.threads
        self.memory_gb -= sign * job.memory_gb
        self.gpus -= sign * job.gpus


def wall_seconds(jobs: Sequence[Job], machine: Machine) -> float:
    """Return when the last job ends, seconds, if each starts as soon as a machine has room for it.

    Of the jobs that wait, the one with the longest chain of followers starts first.

    Parameters
    ----------
    jobs : sequence of Job
        A job stands behind those that it waits for.

    Raises
    ------
    ValueError
        If a job is larger than a machine; the message names it.
    """
    nodes = [_Node(machine.cores, machine.memory_gb, machine.gpus) for _ in range(machine.n_nodes)]
    for job in jobs:
        if not nodes or not nodes[0].fits(job):
            raise ValueError(
                f"{job.rule} needs {job.threads} cores, {job.memory_gb:.1f} GB and {job.gpus} "
                f"GPUs; {machine.name} has {machine.cores}, {machine.memory_gb:g} GB and "
                f"{machine.gpus}"
            )
    rank, followers = _ranks(jobs, machine.start_s)
    missing = [len(job.after) for job in jobs]
    ready = [(-rank[i], i) for i, count in enumerate(missing) if count == 0]
    heapq.heapify(ready)
    running: list[tuple[float, int, int]] = []
    now = 0.0
    while ready or running:
        waiting = []
        while ready:
            item = heapq.heappop(ready)
            job = jobs[item[1]]
            place = next((k for k, node in enumerate(nodes) if node.fits(job)), None)
            if place is None:
                waiting.append(item)
            else:
                nodes[place].take(job, 1)
                end = now + machine.start_s + job.seconds
                heapq.heappush(running, (end, item[1], place))
        for item in waiting:
            heapq.heappush(ready, item)
        now, done, place = heapq.heappop(running)
        nodes[place].take(jobs[done], -1)
        for follower in followers[done]:
            missing[follower] -= 1
            if missing[follower] == 0:
                heapq.heappush(ready, (-rank[follower], follower))
    return now


def _ranks(jobs: Sequence[Job], start_s: float) -> tuple[list[float], list[list[int]]]:
    """Return the length of the chain that starts with each job, seconds, and its followers."""
    followers: list[list[int]] = [[] for _ in jobs]
    for i, job in enumerate(jobs):
        for before in job.after:
            followers[before].append(i)
    rank = [0.0] * len(jobs)
    for i in reversed(range(len(jobs))):
        rank[i] = start_s + jobs[i].seconds + max((rank[k] for k in followers[i]), default=0.0)
    return rank, followers
