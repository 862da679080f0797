"""A long batch with failures injected at random (seeded): run with ``pytest -m slow``."""

import csv
import random
import threading
import time

import numpy as np
import psutil
import pytest
from reliability_scene import odd_clouds
from workspace import Workspace

pytestmark = pytest.mark.slow

N_TREES = 30
SEED = 2026
STAGES = ["import_segmented_cloud", "grow_limbs", "contract_cloud", "extract_graph"]
STAGES += ["measure_traits", "report_tree"]
SPOILT = ["nan", "short", "points_0", "points_1", "label_42", "same", "gone"]
GROWTH = 1.15  # of the memory from the batch's first part to its last, at most


class Watcher(threading.Thread):
    """Kills a stage of chosen trees the first time it runs, and follows the run's memory."""

    def __init__(self, workspace, victims):
        super().__init__(daemon=True)
        self.workspace, self.waiting, self.killed = workspace, dict(victims), {}
        self.memory_mb, self.is_over = [], threading.Event()
        self.process = workspace.start()

    def run(self):
        run = psutil.Process(self.process.pid)
        while self.process.poll() is None:
            for tree, stage in list(self.waiting.items()):
                if (self.workspace.folder / f"logs/status/{tree}/{stage}.json").exists():
                    self._kill(run, tree, stage)
            try:
                self.memory_mb.append((time.monotonic(), run.memory_info().rss / 1e6))
            except psutil.NoSuchProcess:
                break
            time.sleep(0.05)
        self.is_over.set()

    def _kill(self, run, tree, stage):
        try:
            for child in run.children(recursive=True):
                if any(each.path.endswith(f"{stage}/{tree}.log") for each in child.open_files()):
                    child.kill()
                    self.killed[tree] = self.waiting.pop(tree)
                    return
        except psutil.Error:  # a stage that ends at this very moment
            return


def draw(rng):
    """Return what is wrong with which tree: a spoilt cloud, or the stage that is to be killed."""
    spoilt, victims = {}, {}
    for i in range(N_TREES):
        luck = rng.random()
        if luck < 0.25:
            spoilt[f"t{i:02d}"] = rng.choice(SPOILT)
        elif luck < 0.5:
            victims[f"t{i:02d}"] = rng.choice(STAGES[1:])
    return spoilt, victims


def rows_of(workspace):
    with open(workspace.folder / "results/traits.csv", newline="") as stream:
        return {row["tree"]: row for row in csv.DictReader(stream)}


def peaks_mb(workspace, stage, trees):
    """Return the peak memory of a stage for each of the trees, MB."""
    peaks = []
    for tree in trees:
        text = (workspace.folder / f"benchmarks/{stage}/{tree}.tsv").read_text().splitlines()
        value = dict(zip(text[0].split("\t"), text[1].split("\t")))["max_rss"]
        peaks += [float(value)] if value not in ("-", "NA") else []
    return peaks


def test_soak(tmp_path):
    (tmp_path / "project").mkdir()
    workspace = Workspace(tmp_path / "work")
    reasons = odd_clouds(workspace.folder) | {"gone": ("import_cloud", "missing")}
    spoilt, victims = draw(random.Random(SEED))
    names = [f"t{i:02d}" for i in range(N_TREES)]
    for i, name in enumerate(names):
        workspace.add_cloud(name, seed=i)
    workspace.table("tree | cloud", *(f"{t} | {spoilt.get(t, t)}.ply" for t in names))

    watcher = Watcher(workspace, victims)
    watcher.start()
    assert watcher.process.wait(3600) != 0
    watcher.is_over.wait(10)
    rows = rows_of(workspace)
    assert list(rows) == names
    assert len(watcher.killed) >= 0.8 * len(victims), "the stages were too quick to be killed"
    for tree in names:
        row = rows[tree]
        if tree in spoilt:
            stage, reason = reasons[spoilt[tree]]
            assert (row["status"], row["failed_stage"]) == ("failed", stage), row
            assert reason in row["cause"]
        elif tree in watcher.killed:
            assert (row["status"], row["failed_stage"]) == ("interrupted", victims[tree]), row
        else:
            assert row["status"] == "done", row
            assert (workspace.folder / f"results/{tree}/report.html").exists()

    again = workspace.ran(fails=True)
    assert {tree for _, tree in again} == set(watcher.killed), "only what was killed ran again"
    rows = rows_of(workspace)
    assert {tree for tree in names if rows[tree]["status"] != "done"} == set(spoilt)

    memory = np.array([value for _, value in watcher.memory_mb])
    fifth = len(memory) // 5
    early, late = np.median(memory[fifth : 2 * fifth]), np.median(memory[-fifth:])
    print(f"\n{len(spoilt)} spoilt, {len(watcher.killed)} of {len(victims)} killed")
    print(f"Snakemake's memory: {early:.0f} MB early, {late:.0f} MB late")
    assert late < GROWTH * early
    good = [tree for tree in names if tree not in spoilt and tree not in victims]
    for stage in STAGES[1:]:
        first = peaks_mb(workspace, stage, good[: len(good) // 2])
        last = peaks_mb(workspace, stage, good[len(good) // 2 :])
        print(f"{stage}: median peak {np.median(first):.0f} MB, then {np.median(last):.0f} MB")
        assert np.median(last) < GROWTH * np.median(first)
