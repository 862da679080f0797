"""The forecast of a batch: what it adds up, how long it takes at least, and its command."""

import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from workspace import PROJECT, Workspace

from cherrypicker.batch.config import resolve_config
from cherrypicker.batch.forecast import (
    Correction,
    forecast_jobs,
    forecast_text,
    least_hours,
    read_corrections,
)
from cherrypicker.batch.resources import ScanSize, size_of_photos
from cherrypicker.files import load_yaml
from cherrypicker.mvs.backends.table import first_choice

SETTINGS = resolve_config(load_yaml(PROJECT / "workflow/schemas/config.schema.yaml"), {})
SCAN = size_of_photos([(4000, 3000)] * 250, SETTINGS)


def test_stages_add_up_over_scans():
    labelled = ScanSize(("clouds", "labelled"), points_m=1.0, most_points_m=1.0)
    cloud = ScanSize(points_m=1.0, most_points_m=1.0)
    scans = {"a": SCAN, "b": SCAN, "c": labelled, "d": cloud}
    jobs = forecast_jobs(scans)
    depth = next(job for job in jobs if job.rule == "estimate_depth")
    expected = SCAN.cpu_s("estimate_depth")
    assert depth.cpu_s == pytest.approx(expected)
    assert depth.threads > 1
    assert depth.seconds == pytest.approx(expected / depth.threads)
    # 250 photos of 1.92 megapixels: their depths, and two depth and normal maps if kept
    assert depth.disk_gb == pytest.approx(250 * 1.92 * 0.4 / 1000)
    kept = forecast_jobs({"a": replace(SCAN, kept_mp=SCAN.dense_mp)})
    disk = {job.rule: job.disk_gb for job in kept}
    assert disk["estimate_depth"] == pytest.approx(250 * 1.92 * 32.4 / 1000)
    assert Counter(job.rule for job in jobs) >= Counter(
        {"estimate_depth": 2, "import_cloud": 2, "segment_cloud": 3, "grow_limbs": 1}
    )
    assert max(job.threads for job in forecast_jobs(scans, cores=2)) == 2
    printed = {line.split()[0]: line.split()[1:] for line in forecast_text(jobs, 2).splitlines()}
    assert [int(printed[name][0]) for name in ("estimate_depth", "report_tree")] == [2, 4]
    assert float(printed["estimate_depth"][2]) == pytest.approx(2 * expected / 3600, abs=0.01)
    assert float(printed["estimate_depth"][3]) == pytest.approx(depth.seconds / 60, abs=0.1)


def test_the_least_time_is_that_of_busy_cores_or_of_the_longest_tree():
    def hours(n_scans, cores, corrections=None):
        scans = {f"s{i}": SCAN for i in range(n_scans)}
        return least_hours(forecast_jobs(scans, corrections, cores), cores)

    alone = hours(1, 1)
    jobs = forecast_jobs({"s": SCAN}, cores=1)
    assert alone == pytest.approx(sum(job.cpu_s for job in jobs) / 3600)
    assert hours(4, 1) == pytest.approx(4 * alone)
    assert hours(4, 1000) == pytest.approx(hours(1, 1000))
    more = SCAN.cpu_s("estimate_depth") / 3600
    assert hours(1, 1, {"estimate_depth": Correction(cpu=2.0)}) == pytest.approx(alone + more)
    assert hours(0, 1) == 0.0


@pytest.mark.parametrize(
    ("wanted", "with_gpu", "without"),
    [("auto", "cuda", "cpu"), ("cpu", "cpu", "cpu"), ("cuda", "cuda", "cuda")],
)
def test_the_depth_maps_go_to_the_gpu_where_the_config_lets_them(wanted, with_gpu, without):
    assert [first_choice(wanted, has_gpu) for has_gpu in (True, False)] == [with_gpu, without]


def write_benchmark(rule, tree, cpu_s, rss_mb):
    folder = Path("benchmarks")
    (folder / rule).mkdir(parents=True, exist_ok=True)
    text = "s\th:m:s\tmax_rss\tcpu_time\n" + f"9\t0:00:09\t{rss_mb}\t{cpu_s}\n"
    (folder / rule / f"{tree}.tsv").write_text(text)


def test_own_benchmarks_correct_the_rates_when_there_are_enough(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert read_corrections({"s0": SCAN}) == {}
    scans = {f"s{i}": SCAN for i in range(4)}
    cpu_s, rss_mb = SCAN.cpu_s("estimate_depth"), SCAN.memory_mb("estimate_depth")
    # the third resumed half-made work; the last tree is not in the table
    for name, factor in (("s0", 2.0), ("s1", 2.0), ("s2", 0.01), ("gone", 50.0)):
        write_benchmark("estimate_depth", name, factor * cpu_s, 2.6 * rss_mb)
    for name in ("s0", "s1"):
        write_benchmark("fuse_depth", name, 1e6, 1e6)
    for name in ("s0", "s1", "s2"):
        write_benchmark("crop_roi", name, "NA", "NA")
    corrections = read_corrections(scans)
    assert set(corrections) == {"estimate_depth"}
    assert corrections["estimate_depth"] == Correction(
        cpu=pytest.approx(2.0), memory=pytest.approx(2.0), n_benchmarks=3
    )
    for plain, job in zip(forecast_jobs(scans), forecast_jobs(scans, corrections), strict=True):
        factor = 2.0 if job.rule == "estimate_depth" else 1.0
        assert job.cpu_s == pytest.approx(factor * plain.cpu_s)
        assert job.memory_gb == pytest.approx(factor * plain.memory_gb)


def run_command(*arguments, fails=False):
    done = subprocess.run(
        [sys.executable, str(PROJECT / "scripts/forecast.py"), *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=120,
        check=False,
    )
    assert (done.returncode != 0) == fails, done.stdout
    return done.stdout


def test_the_command_reads_the_table_and_writes_nothing(tmp_path):
    workspace = Workspace(tmp_path / "work")
    (workspace.folder / "photos").mkdir()
    for i in range(5):
        photo = Image.fromarray(np.zeros((240, 320, 3), np.uint8))
        photo.save(workspace.folder / f"photos/{i}.jpg")
    workspace.add_cloud("ready")
    workspace.configure({"light": {"enabled": True}}, "c.yaml")
    rows = ["p | photos |  | none | ", "c |  | ready.ply |  | config/c.yaml"]
    workspace.table("tree | photos | cloud | scale | config", *rows)
    before = sorted(workspace.folder.rglob("*"))
    printed = run_command("--directory", workspace.folder)
    rows = {line.split()[0]: line.split() for line in printed.splitlines() if line}
    assert rows["estimate_depth"][1] == "1"
    assert [rows[name][1] for name in ("report_tree", "measure_light")] == ["2", "1"]
    assert "segment_cloud" in rows
    assert "cores: at least" in printed
    assert sorted(workspace.folder.rglob("*")) == before


def test_the_command_plans_scans_that_are_not_taken_yet(tmp_path):
    options = ("--scans", 30, "--photos", 250, "--directory", tmp_path, "--cores", 20)
    large = run_command(*options, "--size", "4000x3000")
    small = run_command(*options, "--size", "2000x1500")
    assert large.startswith("30 scans")
    assert large != small != run_command(*options, "--size", "2000x1500", "--gpu")
    assert "20 cores: at least" in large


def test_the_command_prints_its_formulas():
    printed = run_command("--formulas")
    (line,) = [line for line in printed.splitlines() if line.startswith("| estimate_depth ")]
    assert "260 + 38 sources largest_dense_mp" in line
    assert "32 kept_mp" in line
    (line,) = [line for line in printed.splitlines() if line.startswith("| extract_features ")]
    assert "300 largest_feature_mp" in line


def test_the_command_names_what_is_wrong(tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.table("tree | photos | scale", "p | nowhere | none")
    printed = run_command("--directory", workspace.folder, fails=True)
    assert "tree p" in printed
    assert "nowhere" in printed
    assert "Traceback" not in printed
    assert "no size" in run_command("--photos", 3, "--size", "12MP", fails=True)
