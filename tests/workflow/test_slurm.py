"""Batches through a real Slurm of one node, started for the tests and stopped after them."""

import csv
import subprocess
import sys
import time

import numpy as np
import pytest
from PIL import Image
from slurm_cluster import HOW_TO_INSTALL, SlurmCluster, missing_daemons
from workspace import PROJECT, Workspace

from cherrypicker.batch.config import resolve_config
from cherrypicker.batch.resources import mb_to_ask, minutes_to_ask, size_of_photos, threads_to_ask
from cherrypicker.files import load_yaml

PROFILE = PROJECT / "profiles/slurm"
# The jobs of these tests take seconds, and the folder is a local one
QUICK = ("--slurm-init-seconds-before-status-checks", "2", "--latency-wait", "10")
# The plugin looks at the jobs 10 s later each time that none has ended: here every 2 s
SNAKEMAKE = """
import sys
from snakemake.cli import main
from snakemake_executor_plugin_slurm import Executor
Executor.next_seconds_between_status_checks = property(lambda self: 2, lambda self, longer: None)
sys.exit(main())
"""
GROUP = ("extract_graph", "measure_traits", "report_tree")


@pytest.fixture(scope="module")
def cluster():
    missing = missing_daemons()
    if missing:
        pytest.skip(f"no {', '.join(missing)} here: {HOW_TO_INSTALL}")
    with SlurmCluster(cpus=8) as running:
        yield running


class Run:
    """Snakemake with the Slurm profile, as on a login node."""

    def __init__(self, cluster, workspace, *arguments):
        command = [sys.executable, "-c", SNAKEMAKE, "--snakefile", str(PROJECT / "Snakefile")]
        command += ["--directory", str(workspace.folder), "--workflow-profile", str(PROFILE)]
        self._log = workspace.folder / "printed.txt"
        with self._log.open("w") as stream:
            self._process = subprocess.Popen(
                [*command, *QUICK, *arguments],
                cwd=workspace.folder.parent,
                env=cluster.environment,
                stdout=stream,
                stderr=subprocess.STDOUT,
            )

    def wait_until(self, condition, timeout_s=600):
        """Wait for a condition while Snakemake runs; return what it gave."""
        deadline = time.monotonic() + timeout_s
        try:
            while not (found := condition()):
                assert self._process.poll() is None, self._log.read_text()
                assert time.monotonic() < deadline, self._log.read_text()
                time.sleep(0.1)
        except BaseException:
            self._process.kill()
            raise
        return found

    def stop(self):
        """End a run of which nothing more is asked; what it submitted goes on."""
        self._process.kill()
        self._process.wait()

    def finish(self, fails=False):
        """Wait for the end; return what was printed."""
        self._process.wait(timeout=600)
        printed = self._log.read_text()
        assert (self._process.returncode != 0) == fails, printed
        return printed


def completed(workspace):
    """Return when each (rule, tree) was completed, from the benchmark files."""
    root = workspace.folder / "benchmarks"
    paths = root.rglob("*.tsv")
    return {path.relative_to(root).with_suffix("").parts: path.stat().st_mtime_ns for path in paths}


def status_in_table(results, tree):
    """Return a tree's status in the batch's table."""
    with open(results / "traits.csv", encoding="utf-8", newline="") as stream:
        return {row["tree"]: row["status"] for row in csv.DictReader(stream)}[tree]


def new_jobs(cluster, before):
    return {number: job for number, job in cluster.jobs().items() if number not in before}


def test_a_batch_with_a_cancelled_job_is_finished_by_the_next_call(cluster, tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    workspace.add_cloud("b", seed=1)
    workspace.table("tree | cloud", "a | a.ply", "b | b.ply")
    results = workspace.folder / "results"
    workspace.run("--until", "contract_cloud")  # here, as before a batch moves to the cluster
    run = Run(cluster, workspace, "--retries", "0")

    def running_job_of_b():
        """The job in which b is on its way from the contracted wood to the report."""
        if not (workspace.folder / "logs/extract_graph/b.log").exists():
            return None
        for number, job in cluster.jobs().items():
            script = cluster.ask("scontrol", "write", "batch_script", number, "-")
            if job["JobState"] == "RUNNING" and "extract_graph:tree=b" in script:
                return number
        return None

    cancelled = run.wait_until(running_job_of_b)
    cluster.ask("scancel", cancelled)
    run.finish(fails=True)
    states = {number: job["JobState"] for number, job in cluster.jobs().items()}
    assert states.pop(cancelled) == "CANCELLED"
    assert set(states.values()) == {"COMPLETED"}
    assert (results / "a/report.html").exists()
    assert not (results / "b/report.html").exists()
    # Cancelled within a stage of the group, or between two
    assert status_in_table(results, "b") in ("interrupted", "not run")

    done = completed(workspace)
    before = cluster.jobs()
    Run(cluster, workspace, "results/b/report.html").finish()
    workspace.run()  # here again: the summary
    again = {key for key, stamp in completed(workspace).items() if done.get(key) != stamp}
    assert {("report_tree", "b"), ("summarise_batch",)} <= again
    assert again <= {(stage, "b") for stage in GROUP} | {("summarise_batch",)}
    assert ("contract_cloud", "b") in done
    assert {job["JobState"] for job in new_jobs(cluster, before).values()} == {"COMPLETED"}
    assert (results / "b/report.html").stat().st_size > 0
    assert status_in_table(results, "b") == "done"
    assert workspace.planned() == set()


def test_a_job_killed_for_its_memory_is_tried_again_with_more(cluster, tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    workspace.table("tree | cloud", "a | a.ply")
    before = cluster.jobs()
    target = "results/a/segmented.ply"
    memory = "import_segmented_cloud:mem_mb=60 if attempt == 1 else 900"
    run = Run(cluster, workspace, target, "--set-resources", memory)

    def two_jobs():
        jobs = sorted(new_jobs(cluster, before).items(), key=lambda item: int(item[0]))
        return jobs if len(jobs) == 2 and jobs[1][1]["JobState"] == "COMPLETED" else None

    first, second = run.wait_until(two_jobs)
    run.stop()
    assert first[1]["MinMemoryNode"] == "60M"
    assert first[1]["JobState"] in ("OUT_OF_MEMORY", "FAILED", "CANCELLED")
    assert second[1]["MinMemoryNode"] == "900M"
    assert (workspace.folder / target).stat().st_size > 0


def stand_in_for_earlier_stages(folder):
    """Write files that are there but hold nothing, so that the stereo is next."""
    (folder / "sky").mkdir(parents=True)
    for name in ("cameras", "images", "points3D", "frames", "rigs"):
        (folder / "sfm/model").mkdir(parents=True, exist_ok=True)
        (folder / f"sfm/model/{name}.bin").write_bytes(b"")
    for part in ("images", "sparse"):
        (folder / "dense" / part).mkdir(parents=True)
    for name in ("sky_colors.npz", "poses.npz"):
        (folder / name).write_bytes(b"")
    (folder / "evidence").mkdir()


def test_jobs_ask_for_what_the_photos_need_and_for_a_gpu_only_with_cuda(cluster, tmp_path):
    workspace = Workspace(tmp_path / "work")
    sizes = {"small": (4, (320, 240)), "large": (20, (4000, 3000)), "onGpu": (20, (4000, 3000))}
    workspace.configure({"mvs": {"backend": "cpu"}})
    workspace.configure({"mvs": {"backend": "cuda"}}, "gpu.yaml")
    rows = ["tree | photos | scale | config"]
    for name, (n_photos, (width, height)) in sizes.items():
        (workspace.folder / name).mkdir()
        for i in range(n_photos):
            photo = Image.fromarray(np.zeros((height, width), np.uint8))
            photo.save(workspace.folder / name / f"{i}.png")
        rows.append(f"{name} | {name} | none | {'config/gpu.yaml' if name == 'onGpu' else ''}")
        stand_in_for_earlier_stages(workspace.folder / "results" / name)
    workspace.table(*rows)
    before = cluster.jobs()
    targets = [f"results/{name}/dense/depth.json" for name in sizes]
    only_this = ("--allowed-rules", "estimate_depth", "--retries", "0")
    run = Run(cluster, workspace, *targets, *only_this)
    run.wait_until(lambda: len(new_jobs(cluster, before)) == len(sizes))
    run.stop()
    jobs = {job["Comment"].split("_")[-1]: job for job in new_jobs(cluster, before).values()}
    assert set(jobs) == set(sizes)
    schema = load_yaml(PROJECT / "workflow/schemas/config.schema.yaml")
    settings = resolve_config(schema, {})
    for name, (n_photos, size) in sizes.items():
        mvs = settings["mvs"] | {"backend": "cuda" if name == "onGpu" else "cpu"}
        scan = size_of_photos([size] * n_photos, settings | {"mvs": mvs})
        threads = threads_to_ask("estimate_depth", scan)
        assert jobs[name]["NumCPUs"] == str(threads)
        assert jobs[name]["MinMemoryNode"] in (
            f"{mb_to_ask('estimate_depth', scan, threads)}M",
            f"{mb_to_ask('estimate_depth', scan, threads) / 1024:g}G",
        )
        hours, minutes = divmod(minutes_to_ask("estimate_depth", scan, threads), 60)
        assert jobs[name]["TimeLimit"] == f"{hours:02d}:{minutes:02d}:00"
        assert ("gpu" in jobs[name].get("TresPerJob", "")) == (name == "onGpu")
    assert int(jobs["large"]["NumCPUs"]) > int(jobs["small"]["NumCPUs"])
