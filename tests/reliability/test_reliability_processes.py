"""Kills and crowds: whatever happens to the processes, the results stay the same."""

import csv
import multiprocessing
import os
import random
import select
import shutil
import signal
import subprocess
import sys
import time

import psutil
import pytest
from reliability_scene import same_files
from workspace import PROJECT, Workspace, kill_in_stage

from cherrypicker.files import atomic_path, leftovers, temporary_folder
from cherrypicker.pointcloud import PointCloud, write_cloud
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.seen.sampling import sample_scene

LATE = ["import_cloud", "segment_cloud", "contract_cloud", "extract_graph"]
LATE += ["measure_traits", "report_tree"]


def wait_for(condition, limit_s=240.0):
    """Wait until something holds; fails when it never does."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)


def add_unlabelled(workspace, name):
    """A small generated tree as somebody's dense cloud, without labels."""
    cloud = sample_scene(generate_scene(11, neighbours=0), 12_000, rng=1, extent=1.5)
    write_cloud(workspace.folder / f"{name}.ply", PointCloud(cloud.points, cloud.colors))


@pytest.fixture(scope="module")
def crowded(tmp_path_factory):
    """A batch of one unlabelled cloud that two runs began at once and a third in the midst.

    Returns
    -------
    tuple of Workspace, dict, str
        What each of the two printed with its return code, and what the third printed.
    """
    workspace = Workspace(tmp_path_factory.mktemp("crowded") / "work")
    add_unlabelled(workspace, "a")
    workspace.table("tree | cloud", "a | a.ply")
    told = [workspace.folder.parent / f"{name}.printed" for name in ("first", "second")]
    runs = [workspace.start(printed=path) for path in told]
    wait_for(lambda: any(run.poll() is not None for run in runs))
    late = workspace.run(fails=True)
    codes = [run.wait(240) for run in runs]
    return workspace, {path.read_text(): code for path, code in zip(told, codes)}, late


def test_two_runs_at_once_in_one_folder(crowded):
    """Neither a second start in the same moment nor one in mid-run harms the first."""
    workspace, printed, late = crowded
    assert sorted(printed.values()) == [0, 1]
    refused = [text for text, code in printed.items() if code == 1]
    for text in (*refused, late):
        assert "cannot be locked" in text
    assert "Nothing to be done" in workspace.run()


def test_killed_in_every_stage_of_a_late_cloud(crowded, tmp_path):
    """Kills and crowds disturb in different ways: equal results were disturbed by neither."""
    workspace = Workspace(tmp_path / "work")
    shutil.copy(crowded[0].folder / "a.ply", workspace.folder / "a.ply")
    workspace.table("tree | cloud", "a | a.ply")
    delays = random.Random(7)
    for rule in LATE:
        kill_in_stage(workspace, rule, "a", delays.uniform(0, 0.2) * (rule != LATE[0]))
        if rule == "extract_graph":
            stamp = (workspace.folder / "results/a/contracted.ply").stat().st_mtime_ns
    kill_in_stage(workspace, "summarise_batch", "_batch", 0.0)
    assert "error" not in workspace.run().lower().replace("errors", "")
    assert (workspace.folder / "results/a/contracted.ply").stat().st_mtime_ns == stamp
    results = [each.folder / "results" for each in (workspace, crowded[0])]
    same_files(*results, ignore=("summary.html",))  # it bears the stages' times
    assert "Nothing to be done" in workspace.run()
    assert not list((workspace.folder / "logs/status").rglob("*.json"))


def test_one_stage_killed_for_its_memory_does_not_stop_the_others(tmp_path):
    """What the kernel does when memory runs out: one process dies, the run lives on."""
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    shutil.copy(workspace.folder / "a.ply", workspace.folder / "b.ply")
    workspace.table("tree | cloud", "a | a.ply", "b | b.ply")
    targets = ("--until", "extract_graph")
    process = workspace.start(*targets)
    status = workspace.folder / "logs/status/a/contract_cloud.json"
    wait_for(status.exists)
    (victim,) = [
        child
        for child in psutil.Process(process.pid).children(recursive=True)
        if any(each.path.endswith("contract_cloud/a.log") for each in child.open_files())
    ]
    victim.kill()
    assert process.wait(240) != 0
    with open(workspace.folder / "results/traits.csv", newline="") as stream:
        killed, other = csv.DictReader(stream)
    assert (killed["status"], killed["failed_stage"]) == ("interrupted", "contract_cloud")
    assert "out of memory" in killed["cause"]
    results = workspace.folder / "results"
    assert (results / "b/skeleton.graphml").exists() and other["failed_stage"] == ""
    workspace.run(*targets)
    same_files(results / "a", results / "b")


def _die_while_writing(path, folder):
    with temporary_folder(folder, ".sfm."), atomic_path(path) as temporary:
        temporary.write_bytes(b"half")
        os.kill(os.getpid(), signal.SIGKILL)


def test_a_half_written_file_never_gets_its_final_name_and_goes_later(tmp_path):
    path = tmp_path / "cloud.ply"
    path.write_bytes(b"old")
    process = multiprocessing.get_context("spawn").Process(
        target=_die_while_writing, args=(path, tmp_path)
    )
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    assert path.read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 3  # the file, the half one, the folder
    mine = tmp_path / f".cloud.{os.getpid()}0.part.txt"
    mine.write_bytes(b"of another kind")
    with temporary_folder(tmp_path, ".sfm."), atomic_path(path) as temporary:
        temporary.write_bytes(b"new")
    assert path.read_bytes() == b"new"
    assert sorted(tmp_path.iterdir()) == [mine, path]


def test_a_number_that_another_process_bears_again_keeps_no_leftover(tmp_path):
    """What a living process made stays; what was there before it started is a dead one's."""
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as other:
        folder = tmp_path / f".sfm.{other.pid}"
        folder.mkdir()
        assert not leftovers(tmp_path, ".sfm.")
        before = psutil.Process(other.pid).create_time() - 1.0
        os.utime(folder, (before, before))
        assert leftovers(tmp_path, ".sfm.") == [folder]
        with temporary_folder(tmp_path, ".sfm.") as mine:
            assert list(tmp_path.iterdir()) == [mine]
        os.kill(other.pid, signal.SIGKILL)
        unreaped = psutil.Process(other.pid)
        wait_for(lambda: unreaped.status() == psutil.STATUS_ZOMBIE)
        folder.mkdir()
        assert leftovers(tmp_path, ".sfm.") == [folder]


START = """
import sys
sys.path.insert(0, {scripts!r})
from cherrypicker.batch import run_lock
run_lock.begin_start()
run_lock.begin_start()
print("started", flush=True)
sys.stdin.readline()
run_lock.end_start()
print("next", flush=True)
sys.stdin.readline()
"""


def start_in(folder):
    code = START.format(scripts=str(PROJECT / "scripts"))
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def test_runs_start_one_after_the_other_and_a_killed_one_holds_nobody_up(tmp_path):
    first = start_in(tmp_path)
    assert first.stdout.readline() == "started\n"
    second = start_in(tmp_path)
    assert select.select([second.stdout], [], [], 2.0) == ([], [], []), "it waits"
    first.stdin.write("\n")
    first.stdin.flush()
    assert first.stdout.readline() == "next\n"
    assert second.stdout.readline() == "started\n"
    second.kill()
    third = start_in(tmp_path)
    assert third.stdout.readline() == "started\n"
    for process in (first, second, third):
        process.kill()
        process.communicate()


def test_a_lock_is_released_only_when_nobody_runs(tmp_path):
    lock = tmp_path / ".snakemake/locks/0.input.lock"

    def left_by_next():
        """Whether the lock is still there when the next run has started and ended."""
        run = start_in(tmp_path)
        assert run.stdout.readline() == "started\n"
        run.communicate("\n\n")
        return lock.exists()

    alive = start_in(tmp_path)
    assert alive.stdout.readline() == "started\n"
    alive.stdin.write("\n")
    alive.stdin.flush()
    assert alive.stdout.readline() == "next\n"
    lock.parent.mkdir()
    lock.touch()
    assert left_by_next(), "its owner runs"
    alive.kill()
    alive.communicate()
    note = tmp_path / ".snakemake/running"
    here = note.read_text()
    note.write_text("elsewhere")
    assert left_by_next(), "nobody here can know"
    note.write_text(here)
    assert not left_by_next()
