"""The forecast of a batch: what it adds up, how long machines take, and its command."""

import subprocess
import sys

import numpy as np
import pytest
from PIL import Image
from workspace import PROJECT, Workspace

from cherrypicker.batch.config import load_schema, resolve_config
from cherrypicker.batch.forecast import (
    Correction,
    forecast_hours,
    forecast_stages,
    on_machine,
    read_corrections,
)
from cherrypicker.batch.resources import ScanSize, cpu_seconds, memory_mb, size_of_photos
from cherrypicker.batch.schedule import Job, Machine, wall_seconds

SETTINGS = resolve_config(load_schema(PROJECT / "workflow/schemas/config.schema.yaml"), {})
SCAN = size_of_photos([(4000, 3000)] * 250, SETTINGS)


def machine(n_nodes=1, cores=4, memory_gb=16.0, gpus=0, start_s=0.0):
    return Machine("test", n_nodes, cores, memory_gb, gpus, start_s)


def test_jobs_fill_the_cores_and_chains_wait():
    single = [Job("x", 10.0, 1.0) for _ in range(8)]
    assert wall_seconds(single, machine(cores=4)) == 20.0
    assert wall_seconds(single, machine(n_nodes=2, cores=4)) == 10.0
    assert wall_seconds(single, machine(cores=4, start_s=2.0)) == 24.0
    chain = [Job("x", 10.0, 1.0, after=(i - 1,) if i else ()) for i in range(5)]
    assert wall_seconds(chain, machine(cores=4)) == 50.0
    assert wall_seconds([], machine()) == 0.0


def test_memory_and_gpus_bound_what_runs_at_a_time():
    heavy = [Job("x", 10.0, 9.0) for _ in range(4)]
    assert wall_seconds(heavy, machine(cores=4, memory_gb=16.0)) == 40.0
    assert wall_seconds(heavy, machine(cores=4, memory_gb=18.0)) == 20.0
    on_gpu = [Job("x", 10.0, 1.0, gpus=1) for _ in range(4)]
    assert wall_seconds(on_gpu, machine(cores=4, gpus=2)) == 20.0


def test_long_chains_start_first():
    jobs = [Job("short", 10.0, 1.0), Job("long", 10.0, 1.0), Job("end", 30.0, 1.0, after=(1,))]
    assert wall_seconds(jobs, machine(cores=1)) == 50.0
    jobs = [Job("short", 30.0, 1.0), Job("long", 10.0, 1.0), Job("end", 30.0, 1.0, after=(1,))]
    assert wall_seconds(jobs, machine(cores=2)) == 40.0


@pytest.mark.parametrize("job", [Job("big", 1, 20.0), Job("big", 1, 1, 8), Job("big", 1, 1, 1, 1)])
def test_a_job_larger_than_a_machine_is_named(job):
    with pytest.raises(ValueError, match="big needs"):
        wall_seconds([job], machine())


def test_stages_add_up_over_scans():
    scans = {"a": SCAN, "b": SCAN, "c": ScanSize(points_m=1.0, most_points_m=1.0)}
    rows = {row.rule: row for row in forecast_stages(scans, labelled=["c"])}
    depth = rows["estimate_depth"]
    expected = 2 * cpu_seconds(SCAN.stages["estimate_depth"], SCAN) / 3600
    assert depth.n_jobs == 2
    assert depth.cpu_hours == pytest.approx(expected)
    # two depth maps and two normal maps of 1.92 megapixels, 250 photos, two scans
    assert depth.disk_gb == pytest.approx(2 * 250 * 1.92 * 32 / 1000)
    assert rows["import_cloud"].n_jobs == 1
    assert rows["segment_cloud"].n_jobs == 2
    assert rows["report_tree"].n_jobs == 3
    assert max(row.max_threads for row in forecast_stages(scans, cores=2)) == 2


def test_more_nodes_are_faster_but_no_tree_is_faster_than_its_stages():
    scans = {f"s{i}": SCAN for i in range(4)}
    hours = [
        forecast_hours(scans, machine(n_nodes=n, cores=8, memory_gb=64)) for n in (1, 2, 4, 40)
    ]
    assert hours[0] > 1.7 * hours[1] > 2.5 * hours[2]
    # beyond a node a tree only stages that do not wait for one another gain
    assert hours[2] == pytest.approx(hours[3], rel=0.15)
    cpu_hours = sum(row.cpu_hours for row in forecast_stages(scans))
    assert cpu_hours / 8 < hours[0] < 2.5 * cpu_hours / 8


def test_the_stages_of_a_labelled_cloud_still_follow_one_another():
    cloud = ScanSize(points_m=2.0, most_points_m=2.0)
    hours = forecast_hours({"c": cloud}, machine(cores=8), labelled=["c"])
    rows = forecast_stages({"c": cloud}, labelled=["c"])
    assert "segment_cloud" not in {row.rule for row in rows}
    assert hours == pytest.approx(sum(row.job_minutes for row in rows) / 60)


def test_the_depth_maps_go_to_the_gpu_where_the_config_lets_them():
    scans = dict.fromkeys("abc", SCAN)
    backends = {"a": "auto", "b": "cpu", "c": "cuda"}
    with_gpu = on_machine(scans, backends, machine(gpus=1))
    assert [with_gpu[name].stereo for name in "abc"] == ["cuda", "cpu", "cuda"]
    without = on_machine(scans, backends, machine())
    assert [without[name].stereo for name in "abc"] == ["cpu", "cpu", "cuda"]
    with pytest.raises(ValueError, match="estimate_depth"):
        forecast_hours(without, machine(cores=8, memory_gb=64))


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
    for name in ("one laptop", "one GPU workstation", "20 nodes"):
        assert name in printed
    assert sorted(workspace.folder.rglob("*")) == before


def test_the_command_plans_scans_that_are_not_taken_yet(tmp_path):
    options = ("--scans", 30, "--photos", 250, "--directory", tmp_path)
    machine_options = ("--nodes", 20, "--cores", 16, "--memory_gb", 60)
    large = run_command(*options, "--size", "4000x3000", *machine_options)
    small = run_command(*options, "--size", "2000x1500", *machine_options)
    assert large.startswith("30 scans")
    assert large != small
    assert "20 machines" in large
    assert "does not fit" in run_command(*options, "--nodes", 1, "--cores", 2, "--memory_gb", 1)


def test_the_command_prints_its_formulas():
    printed = run_command("--formulas")
    (line,) = [line for line in printed.splitlines() if line.startswith("| estimate_depth ")]
    assert "260 + stereo_mb" in line
    assert "32 dense_mp" in line
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
