"""The forecast of a batch: what it adds up, how long it takes at least, and its command."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from workspace import PROJECT, Workspace

from cherrypicker.batch.config import resolve_config
from cherrypicker.batch.forecast import (
    Correction,
    forecast_stages,
    least_hours,
    read_corrections,
    with_stereo,
)
from cherrypicker.batch.resources import ScanSize, cpu_seconds, memory_mb, size_of_photos
from cherrypicker.files import load_schema

SETTINGS = resolve_config(load_schema(PROJECT / "workflow/schemas/config.schema.yaml"), {})
SCAN = size_of_photos([(4000, 3000)] * 250, SETTINGS)


def test_stages_add_up_over_scans():
    scans = {"a": SCAN, "b": SCAN, "c": ScanSize(points_m=1.0, most_points_m=1.0)}
    rows = {row.rule: row for row in forecast_stages(scans, labelled=["c"])}
    depth = rows["estimate_depth"]
    expected = 2 * cpu_seconds(SCAN.stages["estimate_depth"], SCAN) / 3600
    assert depth.n_jobs == 2
    assert depth.cpu_hours == pytest.approx(expected)
    assert depth.max_threads > 1  # of which each but the first does four fifths of a core's work
    busy = 1 + 0.8 * (depth.max_threads - 1)
    assert depth.job_minutes == pytest.approx(60 * expected / 2 / busy)
    # 250 photos of 1.92 megapixels, two scans: their depths, and two depth and normal maps if kept
    assert depth.disk_gb == pytest.approx(2 * 250 * 1.92 * 0.4 / 1000)
    kept = forecast_stages({"a": replace(SCAN, keeps_dense=True)})
    disk = {row.rule: row.disk_gb for row in kept}
    assert disk["estimate_depth"] == pytest.approx(250 * 1.92 * 32.4 / 1000)
    assert rows["import_cloud"].n_jobs == 1
    assert rows["segment_cloud"].n_jobs == 2
    assert rows["report_tree"].n_jobs == 3
    assert max(row.max_threads for row in forecast_stages(scans, cores=2)) == 2


def test_the_least_time_is_that_of_busy_cores_or_of_the_longest_tree():
    scans = {f"s{i}": SCAN for i in range(4)}
    alone = least_hours({"s": SCAN}, cores=1)
    rows = forecast_stages({"s": SCAN}, cores=1)
    assert alone == pytest.approx(sum(row.cpu_hours for row in rows))
    assert least_hours(scans, cores=1) == pytest.approx(4 * alone)
    assert least_hours(scans, cores=1000) == pytest.approx(least_hours({"s": SCAN}, cores=1000))
    slower = {"estimate_depth": Correction(cpu=2.0)}
    more = cpu_seconds(SCAN.stages["estimate_depth"], SCAN) / 3600
    assert least_hours({"s": SCAN}, corrections=slower) == pytest.approx(alone + more)
    assert least_hours({}) == 0.0


def test_the_depth_maps_go_to_the_gpu_where_the_config_lets_them():
    scans = dict.fromkeys("abc", SCAN)
    backends = {"a": "auto", "b": "cpu", "c": "cuda"}
    with_gpu = with_stereo(scans, backends, True)
    assert [with_gpu[name].stereo for name in "abc"] == ["cuda", "cpu", "cuda"]
    without = with_stereo(scans, backends, False)
    assert [without[name].stereo for name in "abc"] == ["cpu", "cpu", "cuda"]


def write_benchmark(folder, rule, tree, cpu_s, rss_mb):
    (folder / rule).mkdir(parents=True, exist_ok=True)
    text = "s\th:m:s\tmax_rss\tcpu_time\n" + f"9\t0:00:09\t{rss_mb}\t{cpu_s}\n"
    (folder / rule / f"{tree}.tsv").write_text(text)


def test_own_benchmarks_correct_the_rates_when_there_are_enough(tmp_path):
    scans = {f"s{i}": SCAN for i in range(4)}
    stage = SCAN.stages["estimate_depth"]
    cpu_s, rss_mb = cpu_seconds(stage, SCAN), memory_mb(stage, SCAN)
    # the third resumed half-made work; the last tree is not in the table
    for name, factor in (("s0", 2.0), ("s1", 2.0), ("s2", 0.01), ("gone", 50.0)):
        write_benchmark(tmp_path, "estimate_depth", name, factor * cpu_s, 2.6 * rss_mb)
    for name in ("s0", "s1"):
        write_benchmark(tmp_path, "fuse_depth", name, 1e6, 1e6)
    for name in ("s0", "s1", "s2"):
        write_benchmark(tmp_path, "crop_roi", name, "NA", "NA")
    corrections = read_corrections(tmp_path, scans)
    assert set(corrections) == {"estimate_depth"}
    assert corrections["estimate_depth"] == Correction(
        cpu=pytest.approx(2.0), memory=pytest.approx(2.0), n_benchmarks=3
    )
    plain = {row.rule: row for row in forecast_stages(scans)}
    corrected = {row.rule: row for row in forecast_stages(scans, corrections=corrections)}
    for rule, row in corrected.items():
        factor = 2.0 if rule == "estimate_depth" else 1.0
        assert row.cpu_hours == pytest.approx(factor * plain[rule].cpu_hours)
        assert row.memory_gb == pytest.approx(factor * plain[rule].memory_gb)
    assert read_corrections(tmp_path / "missing", scans) == {}


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
    workspace.table("tree | photos | cloud | scale", "p | photos |  | none", "c |  | ready.ply | ")
    before = sorted(workspace.folder.rglob("*"))
    printed = run_command("--directory", workspace.folder)
    rows = {line.split()[0]: line.split() for line in printed.splitlines() if line}
    assert rows["estimate_depth"][1] == "1"
    assert rows["report_tree"][1] == "2"
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
    assert "260 + stereo_mb" in line
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
