"""Kills and crowds: whatever happens to the processes, the results are those of a quiet run."""

import csv
import json
import multiprocessing
import os
import random
import select
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest
from reliability_scene import same_files
from sfm_scene import centers_of, similarity_errors, write_orbit
from workspace import PROJECT, Workspace, kill_group

from cherrypicker.files import atomic_path, leftovers, temporary_folder
from cherrypicker.pointcloud import PointCloud, write_cloud
from cherrypicker.poses import read_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.seen.sampling import sample_scene

LATE = ["import_cloud", "segment_cloud", "contract_cloud", "extract_graph"]
LATE += ["measure_traits", "report_tree"]
SPARSE = ["extract_features", "match_features", "reconstruct_sparse"]
DENSE = ["undistort_photos", "estimate_depth", "fuse_depth"]
CLOUD = "results/box/cloud.ply"
# What COLMAP's own threads may change in the last digits, relative to the cameras' distance.
COLMAP_TOLERANCE = 1e-3


def wait_for(condition, limit_s=240.0):
    """Wait until something holds; fails when it never does."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)


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


def add_unlabelled(workspace, name):
    """A small generated tree as somebody's dense cloud, without labels."""
    cloud = sample_scene(generate_scene(11, neighbours=0), 12_000, rng=1, extent=1.5)
    write_cloud(workspace.folder / f"{name}.ply", PointCloud(cloud.points, cloud.colors))


@pytest.fixture(scope="module")
def quiet(tmp_path_factory):
    """A batch of one unlabelled cloud that nobody disturbed."""
    workspace = Workspace(tmp_path_factory.mktemp("quiet") / "work")
    add_unlabelled(workspace, "a")
    workspace.table("tree | cloud", "a | a.ply")
    workspace.run()
    return workspace


def test_killed_in_every_stage_of_a_late_cloud(quiet, tmp_path):
    workspace = Workspace(tmp_path / "work")
    shutil.copy(quiet.folder / "a.ply", workspace.folder / "a.ply")
    workspace.table("tree | cloud", "a | a.ply")
    delays = random.Random(7)
    for rule in LATE:
        kill_in_stage(workspace, rule, "a", delays.uniform(0, 0.2) * (rule != LATE[0]))
        if rule == "extract_graph":
            stamp = (workspace.folder / "results/a/contracted.ply").stat().st_mtime_ns
    kill_in_stage(workspace, "summarise_batch", "_batch", 0.0)
    assert "error" not in workspace.run().lower().replace("errors", "")
    assert (workspace.folder / "results/a/contracted.ply").stat().st_mtime_ns == stamp
    results = [each.folder / "results" for each in (workspace, quiet)]
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


def test_two_runs_at_once_in_one_folder(quiet, tmp_path):
    """Neither a second start in the same moment nor one in mid-run harms the first."""
    workspace = Workspace(tmp_path / "work")
    shutil.copy(quiet.folder / "a.ply", workspace.folder / "a.ply")
    workspace.table("tree | cloud", "a | a.ply")
    contracted = "results/a/contracted.ply"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    runs = [
        subprocess.Popen(workspace.command(contracted), cwd=workspace.folder.parent, **pipes)
        for _ in range(2)
    ]
    wait_for(lambda: any(run.poll() is not None for run in runs))
    late = workspace.run(contracted, fails=True)
    printed = {run.communicate()[0]: run.returncode for run in runs}
    assert sorted(printed.values()) == [0, 1]
    refused = [text for text, code in printed.items() if code == 1]
    for text in (*refused, late):
        assert "cannot be locked" in text
    assert (workspace.folder / contracted).read_bytes() == (quiet.folder / contracted).read_bytes()
    assert "Nothing to be done" in workspace.run(contracted)


@pytest.mark.parametrize("stage", SPARSE + DENSE)
def test_killed_in_every_stage_from_photos_to_the_cloud(box, stage):
    """In order, on one workspace; each kill interrupts the stage that is due."""
    kill_in_stage(box.disturbed, stage, "box", 0.05, CLOUD)
    if stage == DENSE[-1]:
        box.disturbed.run(CLOUD)
        first, second = (w.folder / "results/box" for w in (box.disturbed, box.quiet))
        for name in ("features.db", "photos.json", "database.db"):
            assert (first / "sfm" / name).read_bytes() == (second / "sfm" / name).read_bytes()
        poses = [read_poses(folder / "poses.npz") for folder in (first, second)]
        assert list(poses[0].names) == list(poses[1].names)
        spread = np.linalg.norm(np.ptp(poses[1].centers, axis=0))
        errors = similarity_errors(poses[0].centers, poses[1].centers)
        assert errors.max() < COLMAP_TOLERANCE * spread
        assert similarity_errors(poses[0].centers, centers_of(box.truth)).max() < 0.1
        if (first / "poses.npz").read_bytes() == (second / "poses.npz").read_bytes():
            assert (first / "cloud.ply").read_bytes() == (second / "cloud.ply").read_bytes()
        assert not [path for path in first.rglob(".*") if path.is_dir() or ".part" in path.name]
        assert "Nothing to be done" in box.disturbed.run(CLOUD)


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    """The photos of a textured box, twice: taken quietly to its cloud, and not yet."""

    class Pair:
        pass

    pair = Pair()
    for name in ("quiet", "disturbed"):
        workspace = Workspace(tmp_path_factory.mktemp(name) / "work")
        _, pair.truth = write_orbit(workspace.folder / "photos", 6, span_deg=80.0)
        workspace.configure({"sfm": {"max_features": 800}, "mvs": {"backend": "cpu"}})
        workspace.table("tree | photos | scale", "box | photos | none")
        setattr(pair, name, workspace)
    pair.quiet.run(CLOUD)
    return pair


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
