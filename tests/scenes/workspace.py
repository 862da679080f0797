"""A working directory for real Snakemake runs, and a small tree to put into it."""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from snakemake_fork import Run

from cherrypicker.classes import Label
from cherrypicker.pointcloud import PointCloud, write_cloud

PROJECT = Path(__file__).resolve().parents[2]


def small_tree(seed: int = 0, n_points: int = 5000) -> PointCloud:
    """A labelled tree 1.2 m tall: a straight stem and four straight branches, 2 mm of noise."""
    rng = np.random.default_rng(seed)
    limbs = [(np.zeros(3), np.array([0.0, 0.0, 1.2]), 0.03, Label.TRUNK)]
    for i in range(4):
        azimuth = 2.1 * i + 0.3 * seed
        start = np.array([0.0, 0.0, 0.5 + 0.15 * i])
        direction = np.array([np.cos(azimuth), np.sin(azimuth), 0.7])
        limbs.append(
            (start, start + 0.5 * direction / np.linalg.norm(direction), 0.01, Label.BRANCH)
        )
    areas = np.array([radius * np.linalg.norm(end - start) for start, end, radius, _ in limbs])
    counts = np.maximum((n_points * areas / areas.sum()).astype(int), 200)
    points, labels = [], []
    for (start, end, radius, label), count in zip(limbs, counts):
        axis = (end - start) / np.linalg.norm(end - start)
        across = np.linalg.svd(axis[None])[2][1:]
        along, angle = rng.random(count), rng.uniform(0, 2 * np.pi, count)
        ring = np.cos(angle)[:, None] * across[0] + np.sin(angle)[:, None] * across[1]
        points.append(start + along[:, None] * (end - start) + radius * ring)
        labels.append(np.full(count, label, dtype=np.uint8))
    points = np.concatenate(points)
    points += rng.normal(0, 0.002, points.shape)
    return PointCloud(points, fields={"label": np.concatenate(labels)})


class Workspace:
    """A working directory beside the project, run as a user runs it."""

    def __init__(self, folder: Path, project: Path = PROJECT):
        self.folder, self.project = folder, project
        (folder / "config").mkdir(parents=True)
        self.configure({})

    def configure(self, config: dict, name: str = "config.yaml") -> None:
        if name == "config.yaml":  # small figures, or a small tree's report takes longest
            config = {"report": {"figure_width_px": 400}, **config}
        (self.folder / "config" / name).write_text(yaml.safe_dump(config), encoding="utf-8")

    def table(self, *rows: str) -> None:
        text = "\n".join(row.replace(" | ", "\t") for row in rows) + "\n"
        (self.folder / "config/trees.tsv").write_text(text, encoding="utf-8")

    def add_cloud(self, name: str, seed: int = 0) -> None:
        write_cloud(self.folder / f"{name}.ply", small_tree(seed))

    def arguments(self, *arguments: str) -> list[str]:
        return [
            *("--snakefile", str(self.project / "Snakefile")),
            *("--directory", str(self.folder), "--cores", "2", *arguments),
        ]

    def run(self, *arguments: str, fails: bool = False, limit_s: float = 600) -> str:
        """Run Snakemake; return what it printed."""
        printed = self.folder.parent / f"{self.folder.name}.printed"
        code = self._started(printed, *arguments).wait(limit_s)
        text = printed.read_text(encoding="utf-8")
        assert (code != 0) == fails, text
        return text

    def start(self, *arguments: str, printed: str | os.PathLike = os.devnull) -> Run:
        """Start Snakemake in a process group of its own, which prints to a file."""
        return self._started(Path(printed), *arguments)

    def _started(self, printed: Path, *arguments: str) -> Run:
        environment = {**os.environ, "PYTHONPATH": ""}
        return Run(self.arguments(*arguments), self.folder.parent, environment, printed)

    def ran(self, *arguments: str, fails: bool = False) -> set[tuple[str, str]]:
        """Run Snakemake; return the (rule, tree) pairs that it completed."""
        before = self._benchmarks()
        self.printed = self.run(*arguments, fails=fails)
        after = self._benchmarks()
        return {key for key, time in after.items() if before.get(key) != time}

    def planned(self, *arguments: str) -> set[tuple[str, str]]:
        """Return the (rule, tree) pairs that :meth:`ran` would return, without running them."""
        self.printed = self.run("--summary", *arguments)
        rows = [line.split("\t") for line in self.printed.splitlines()]
        pending = {(row[0], row[2]) for row in rows if row[-1] == "update pending"}
        return {(rule, "/".join(Path(output).parts[1:-1][:1])) for output, rule in pending}

    def _benchmarks(self) -> dict[tuple[str, str], int]:
        root = self.folder / "benchmarks"
        return {
            (path.parent.relative_to(root).as_posix(), path.stem)
            if path.parent != root
            else (path.stem, ""): path.stat().st_mtime_ns
            for path in root.rglob("*.tsv")
        }


def kill_group(process: Run) -> None:
    """Kill a process and everything that it started, as a power cut does; one may have ended."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def try_to_kill_in_stage(workspace, rule, tree, delay_s, *targets):
    """Kill a whole run, as a power cut does; whether the stage was at work then.

    The run is stopped while it is looked at, every 2 ms, so that no stage is over in the meantime.
    """
    status = workspace.folder / "logs/status" / tree / f"{rule}.json"
    process = workspace.start(*targets)
    while process.poll() is None:
        os.killpg(process.pid, signal.SIGSTOP)
        if status.exists():
            break
        os.killpg(process.pid, signal.SIGCONT)
        time.sleep(0.002)
    if delay_s and process.poll() is None:
        os.killpg(process.pid, signal.SIGCONT)
        time.sleep(delay_s)
    kill_group(process)
    return status.exists() and json.loads(status.read_text())["state"] == "running"


def kill_in_stage(workspace, rule, tree, delay_s, *targets):
    """Kill a whole run while a stage works; one that was over before it was seen is run again."""
    for again in ((), *4 * [("--forcerun", rule)]):
        if try_to_kill_in_stage(workspace, rule, tree, delay_s, *targets, *again):
            return
        delay_s = 0.0
    pytest.fail(f"{rule} was never seen at work")


def project_with_own(module: str, target: Path) -> Path:
    """Return a project with one module to edit; all else is linked; kernels compile anew."""
    source, folder = PROJECT, target
    for part in Path(module).parts:
        folder.mkdir(exist_ok=True)
        for child in source.iterdir():
            if child.name not in (part, "__pycache__"):
                (folder / child.name).symlink_to(child)
        source, folder = source / part, folder / part
    shutil.copy2(source, folder)
    return target
