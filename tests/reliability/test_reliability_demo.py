"""Kill -9 in every stage from photos of a demo tree: run with ``pytest -m slow`` (10 minutes)."""

import csv
import random
import shutil

import numpy as np
import pytest
from reliability_scene import same_files
from sfm_scene import COLMAP_TOLERANCE, similarity_errors
from workspace import PROJECT, Workspace, try_to_kill_in_stage

from cherrypicker.poses import read_poses

pytestmark = pytest.mark.slow

TREE = "cherry_leader"
STAGES = ["segment_sky", "extract_features", "match_features", "reconstruct_sparse"]
STAGES += ["undistort_photos", "gather_evidence", "estimate_depth", "fuse_depth", "align_cloud"]
STAGES += ["crop_roi", "denoise_cloud", "estimate_scale", "scale_cloud", "segment_cloud"]
STAGES += ["contract_cloud", "extract_graph", "check_photos", "measure_traits", "report_tree"]
COLMAPS = ["poses.npz", "sfm/report.json", "sfm/model"]
LIMIT_S = 3600
# Two half rings of 12 photos, and small depth maps: what is at stake is the same at any size.
CONFIG = {"sfm": {"max_features": 2000}, "mvs": {"backend": "cpu", "max_image_size_px": 500}}


def demo_workspace(folder):
    """A working directory with one of the demo's trees, as its table has it."""
    workspace = Workspace(folder)
    with open(PROJECT / "config/trees.tsv", newline="") as stream:
        (row,) = [r for r in csv.DictReader(stream, delimiter="\t") if r["tree"] == TREE]
    (folder / "photos").mkdir()
    for number in (*range(1, 13), *range(21, 33)):
        name = f"IMG_{number:04d}.jpg"
        (folder / "photos" / name).symlink_to(PROJECT / row["photos"] / name)
    row["photos"] = "photos"
    workspace.table(" | ".join(row), " | ".join(row.values()))
    workspace.configure(CONFIG)
    return workspace


def seconds_of(workspace, stage):
    lines = (workspace.folder / f"benchmarks/{stage}/{TREE}.tsv").read_text().splitlines()
    return float(dict(zip(lines[0].split("\t"), lines[1].split("\t")))["s"])


def take_over_colmaps_model(disturbed, quiet):
    """Compare the sparse models, then go on from the same one: its last digits are COLMAP's."""
    poses = [read_poses(folder / "poses.npz") for folder in (disturbed, quiet)]
    assert list(poses[0].names) == list(poses[1].names)
    spread = np.linalg.norm(np.ptp(poses[1].centers, axis=0))
    errors = similarity_errors(poses[0].centers, poses[1].centers)
    print(f"\nlargest difference of a camera: {errors.max() / spread:.2e} of the scene")
    assert errors.max() < COLMAP_TOLERANCE * spread
    for name in COLMAPS:
        if (quiet / name).is_dir():
            shutil.copytree(quiet / name, disturbed / name, dirs_exist_ok=True)
        else:
            shutil.copyfile(quiet / name, disturbed / name)


def test_every_stage_of_a_demo_tree_survives_a_kill(tmp_path):
    quiet = demo_workspace(tmp_path / "quiet")
    quiet.run(limit_s=LIMIT_S)
    disturbed = demo_workspace(tmp_path / "disturbed")
    folders = [workspace.folder / "results" / TREE for workspace in (disturbed, quiet)]
    delays = random.Random(11)
    for stage in STAGES:
        if stage == "undistort_photos":
            disturbed.run("--until", "reconstruct_sparse", limit_s=LIMIT_S)
            take_over_colmaps_model(*folders)
        delay_s = delays.uniform(0.0, 0.25) * seconds_of(quiet, stage)
        print(f"killed in {stage} after {delay_s:.1f} s", flush=True)
        targets = ["--until", stage]
        # On a machine with other work a stage may take a quarter of the time of the quiet run.
        while not try_to_kill_in_stage(disturbed, stage, TREE, delay_s, *targets):
            delay_s /= 2
            targets = ["--until", stage, "--forcerun", stage]
    disturbed.run(limit_s=LIMIT_S)
    results = [workspace.folder / "results" for workspace in (disturbed, quiet)]
    same_files(*results, ignore=("summary.html",))  # it bears the stages' times
    assert "Nothing to be done" in disturbed.run()
