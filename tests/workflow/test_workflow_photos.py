"""Scans from photos: what is cached step by step, and how bad scans end, by real Snakemake runs."""

import csv
import re
import shutil

import cv2
import numpy as np
import pytest
from sfm_scene import COLMAP_TOLERANCE, centers_of, similarity_errors, texture, write_orbit
from workspace import Workspace, kill_in_stage

from cherrypicker.mvs.depth_rasters import read_depth_raster
from cherrypicker.poses import read_poses

SPARSE = ["extract_features", "match_features", "reconstruct_sparse"]
DENSE = ["undistort_photos", "gather_evidence", "estimate_depth", "fuse_depth"]
LEAN = {"sfm": {"max_features": 800}, "mvs": {"backend": "cpu"}}
CONFIG = {**LEAN, "keep": {"dense": True}}
CLOUD = "results/box/cloud.ply"
KEPT = ["coverage.json", "depth.json", "poses.npz"]


def of_box(*stages):
    return {(stage, "box") for stage in stages}


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    """Photos of a textured box, taken as far as the dense cloud."""
    workspace = Workspace(tmp_path_factory.mktemp("photo batch") / "work")
    _, workspace.truth = write_orbit(workspace.folder / "photos", 6, span_deg=80.0)
    workspace.configure(CONFIG)
    workspace.table("tree | photos | scale", "box | photos | none")
    workspace.first = workspace.ran(CLOUD)
    return workspace


def test_seven_steps_lead_from_photos_to_the_cloud(box):
    assert box.first == of_box(*SPARSE, "segment_sky", *DENSE)
    assert "Nothing to be done" in box.run(CLOUD)


@pytest.fixture(scope="module")
def disturbed(box, tmp_path_factory):
    """The same photos, of which nothing is made yet."""
    workspace = Workspace(tmp_path_factory.mktemp("disturbed") / "work")
    shutil.copytree(box.folder / "photos", workspace.folder / "photos")
    shutil.copytree(box.folder / "config", workspace.folder / "config", dirs_exist_ok=True)
    return workspace


@pytest.mark.parametrize("stage", [each for each in SPARSE + DENSE if each != "gather_evidence"])
def test_killed_in_every_stage_it_ends_as_if_undisturbed(box, disturbed, stage):
    """In order, on one workspace; each kill interrupts the stage that is due."""
    kill_in_stage(disturbed, stage, "box", 0.05, CLOUD)
    if stage == DENSE[-1]:
        disturbed.run(CLOUD)
        first, second = (each.folder / "results/box" for each in (disturbed, box))
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
        assert "Nothing to be done" in disturbed.run(CLOUD)


@pytest.mark.parametrize(
    ("section", "key", "value", "stages"),
    [
        ("mvs", "silhouettes", False, DENSE[3:]),
        ("mvs", "n_iterations", 2, DENSE[2:]),
        ("mvs", "max_image_size_px", 240, DENSE),
        ("sfm", "min_registered_fraction", 0.4, [SPARSE[2], *DENSE]),
        ("sfm", "exhaustive_max_photos", 90, [*SPARSE[1:], *DENSE]),
    ],
)
def test_each_step_is_cached_by_itself(box, section, key, value, stages):
    box.configure({**CONFIG, section: {**CONFIG[section], key: value}})
    assert box.planned(CLOUD) == of_box(*stages)


def test_a_changed_step_is_run_with_what_follows(box):
    box.configure({**CONFIG, "mvs": {**CONFIG["mvs"], "min_views": 3}})
    assert box.ran(CLOUD) == of_box(*DENSE[3:])
    assert "Nothing to be done" in box.run(CLOUD)


def test_what_killed_runs_left_of_the_maps_is_taken_up(box):
    """A whole map of the same settings is not made again, and nothing undeclared stays."""
    dense = box.folder / "results/box/dense"
    left = dense / ".stereo"
    shutil.copytree(dense / "stereo", left / "stereo")
    before = {path.name: path.stat().st_ino for path in (left / "stereo/depth_maps").iterdir()}
    box.configure(CONFIG)
    box.run(CLOUD, "--forcerun", "estimate_depth")
    assert not left.exists()
    after = {path.name: path.stat().st_ino for path in (dense / "stereo/depth_maps").iterdir()}
    assert after == before


def test_prepared_photos_are_read_by_every_stage(box):
    """Half of each photo hidden by the user's masks: a stage more, and nothing of that half."""
    (box.folder / "own").mkdir()
    for path in sorted((box.folder / "photos").iterdir()):
        mask = np.full(cv2.imread(str(path)).shape[:2], 255, np.uint8)
        mask[:, :100] = 0
        cv2.imwrite(str(box.folder / f"own/{path.stem}.png"), mask)
    box.configure(LEAN)
    box.table("tree | photos | scale | masks", "half | photos | none | own")
    cloud = "results/half/cloud.ply"
    stages = {"prepare_photos", *SPARSE, "segment_sky", *DENSE}
    assert box.ran(cloud) == {(stage, "half") for stage in stages}
    assert "Nothing to be done" in box.run(cloud)
    results = box.folder / "results/half"
    assert (results / "photos/photo 00.jpg").samefile(box.folder / "photos/photo 00.jpg")
    assert sorted(path.name for path in (results / "dense").iterdir()) == KEPT
    for name in read_poses(results / "dense/poses.npz").names:
        shown = read_depth_raster(results / "depth", name) > 0
        assert not shown[:, :90].any() and shown[:, 110:].any()
    # What is large is gone, and no later stage asks for it; the fusion itself would
    assert box.planned("results/half/aligned.ply") == {("align_cloud", "half")}
    box.configure({**LEAN, "mvs": {"backend": "cpu", "min_views": 3}})
    assert box.planned(cloud) == {(stage, "half") for stage in DENSE}


def test_bad_scans_end_with_one_line_each_and_the_batch_goes_on(box):
    folder = box.folder
    (folder / "none").mkdir()
    rng = np.random.default_rng(5)
    (folder / "strangers").mkdir()
    for i in range(4):
        cv2.imwrite(str(folder / f"strangers/{i}.jpg"), texture(rng, 320)[:240])
    (folder / "phone").mkdir()
    (folder / "phone/IMG_1.HEIC").write_bytes(b"no photo")
    box.table(
        "tree | photos | scale | marker_dictionary | marker_sides_m | masks",
        "none | none | none |  |  | ",
        "gone | nowhere | none |  |  | ",
        "phone | phone | none |  |  | ",
        "masked | photos | none |  |  | nowhere",
        "strangers | strangers | none |  |  | ",
        "box | photos |  | DICT_4X4_50 | 7:0.2 | ",
    )
    printed = box.run("--until", "estimate_scale", fails=True)
    # Snakemake's own blocks are longer than a pipe takes at once: a line may begin within one
    errors = re.findall(r"ERROR tree=.*", printed)
    expected = {
        "none": ("extract_features", "none", "photos"),
        "gone": ("extract_features", "nowhere", "photos"),
        "phone": ("prepare_photos", "IMG_1.HEIC", "photos"),
        "masked": ("prepare_photos", "nowhere", "masks"),
        "strangers": ("match_features", "strangers", "photos"),
        "box": ("estimate_scale", "photos", "marker"),
    }
    for tree, (rule, file, key) in expected.items():
        (line,) = [line for line in errors if line.startswith(f"ERROR tree={tree} ")]
        assert f"rule={rule}:" in line
        assert file in line
        assert key in line.split("change:")[1]
    with open(folder / "results/traits.csv", newline="") as stream:
        rows = {row["tree"]: row for row in csv.DictReader(stream)}
    for tree, (rule, *_) in expected.items():
        assert rule in rows[tree].values(), rows[tree]
