"""The benchmark's rules, its true cameras, its measurements and its tables."""

import json

import numpy as np
import pycolmap
import pytest
from PIL import Image
from stereo_scene import Surface, write_scene
from workspace import Workspace as Run

from cherrypicker.batch.config import resolve_config
from cherrypicker.errors import StageError
from cherrypicker.files import load_schema, write_json
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.fusion import FusionOptions
from cherrypicker.photos import list_photos
from cherrypicker.pointcloud import write_cloud
from cherrypicker.poses import Poses, write_poses
from cherrypicker.sfm.features import extract_features
from cherrypicker.sfm.matching import match_features
from cherrypicker_lab.dense.backends import backends_here
from cherrypicker_lab.dense.figures import (
    depth_figure,
    error_figure,
    save,
    score_figure,
    time_figure,
)
from cherrypicker_lab.dense.jobs import benchmark_runs, megapixels_of, scan_folders
from cherrypicker_lab.dense.measure import measure_stereo
from cherrypicker_lab.dense.results import read_results, write_table
from cherrypicker_lab.dense.surface import CLASSES
from cherrypicker_lab.dense.true_cameras import triangulate_true_cameras


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """An upright cylinder before a plane, five photos; their true poses beside them."""
    folder = tmp_path_factory.mktemp("scene")
    surfaces = [Surface(seed=1), Surface(radius=0.3, center=(0.2, 0.0, 3.4), seed=2)]
    K, poses, _ = write_scene(folder, surfaces, n_views=5, width=480, height=360)
    names = [path.name for path in list_photos(folder / "images")]
    motions = np.array([np.c_[R, t] for R, t in poses])
    true = Poses(names, motions, np.repeat([K], 5, axis=0), [480] * 5, [360] * 5)
    write_poses(folder / "poses.npz", true)
    return folder, true


@pytest.fixture(scope="module")
def matched(scene, tmp_path_factory):
    folder, _ = scene
    out = tmp_path_factory.mktemp("matched")
    extract_features(list_photos(folder / "images"), out / "features.db", out / "photos.json")
    match_features(out / "features.db", out / "database.db")
    return out / "database.db"


def test_true_cameras_stay_and_points_come_from_the_photos(scene, matched, tmp_path):
    folder, true = scene
    report = triangulate_true_cameras(
        matched, folder / "images", folder / "poses.npz", tmp_path / "model"
    )
    model = pycolmap.Reconstruction(tmp_path / "model")
    assert report["n_photos"] == len(model.images) == 5
    assert model.num_points3D() > 50
    for image in model.images.values():
        pose = true.cam_from_world[list(true.names).index(image.name)]
        np.testing.assert_allclose(image.cam_from_world().matrix(), pose, atol=1e-12)
        np.testing.assert_allclose(image.camera.calibration_matrix(), true.K[0])
    points = np.array([point.xyz for point in model.points3D.values()])
    off_plane = np.abs(points[:, 2] - 4.0)
    off_cylinder = np.abs(np.hypot(points[:, 0] - 0.2, points[:, 2] - 3.4) - 0.3)
    assert np.median(np.minimum(off_plane, off_cylinder)) < 0.02
    # triangulated, not copied from the surface
    assert np.minimum(off_plane, off_cylinder).max() > 1e-6


def test_photos_without_a_true_pose_are_named(scene, matched, tmp_path):
    folder, true = scene
    write_poses(tmp_path / "poses.npz", true.select(np.arange(4)))
    with pytest.raises(StageError, match=str(true.names[4])):
        triangulate_true_cameras(
            matched, folder / "images", tmp_path / "poses.npz", tmp_path / "model"
        )


@pytest.mark.parametrize("backend", ["cpu", "sgbm"])
def test_a_measurement_says_what_it_cost(scene, tmp_path, backend):
    folder, _ = scene
    before = sorted(path.name for path in folder.rglob("*"))
    report, cloud = measure_stereo(
        folder, tmp_path / "dense", backend, StereoOptions(), FusionOptions(min_views=2),
        max_photos=4,
    )  # fmt: skip
    assert report["n_photos"] == 4
    assert report["megapixels"] == pytest.approx(4 * 480 * 360 / 1e6)
    per_megapixel = report["depth"]["cpu_s"] / report["megapixels"]
    assert report["cpu_s_per_megapixel"] == pytest.approx(per_megapixel)
    assert 0.05 < report["depth"]["cpu_s"] < 60
    assert 30 < report["depth"]["peak_mb"] <= report["fusion"]["peak_mb"]
    assert report["agreement"]["share"] > 0.6
    assert report["n_points"] == len(cloud) > 1000
    assert sorted(path.name for path in folder.rglob("*")) == before
    json.dumps(report)


def test_figures_show_every_run(scene, tmp_path):
    """A measured run with made-up scores goes through all four figures."""
    run = tmp_path / "wall" / "true" / "full" / "sgbm"
    report, cloud = measure_stereo(
        scene[0], run / "dense", "sgbm", StereoOptions(), FusionOptions(min_views=2)
    )
    write_json(run / "measurement.json", {"scan": "wall", "cameras": "true", **report})
    write_json(run / "scores.json", {name: rates(0.5) for name in ("all", *CLASSES)})
    error = np.linspace(0.0, 0.03, len(cloud)).astype(np.float32)
    write_cloud(run / "scored.ply", cloud.with_fields(error=error))
    results = read_results([run / "measurement.json"])
    made = (time_figure(results), score_figure(results), depth_figure(results),
            error_figure(results))  # fmt: skip
    for i, figure in enumerate(made):
        path = tmp_path / f"{i}.png"
        save(figure, path)
        pixels = np.asarray(Image.open(path).convert("RGB")).reshape(-1, 3)
        assert len(np.unique(pixels, axis=0)) > 50
    save(time_figure(results), tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "0.png").read_bytes()
    depth = made[2].axes[1].images[0].get_array()
    assert 3.0 < np.nanmedian(depth.filled(np.nan)) < 4.2


def test_a_backend_that_cannot_run_is_refused(scene, tmp_path):
    missing = "cuda" if "cuda" not in backends_here() else "metal"
    with pytest.raises(StageError, match="cannot run here"):
        measure_stereo(scene[0], tmp_path, missing, StereoOptions(), FusionOptions())


def section(project, **values):
    schema = load_schema(project / "workflow/schemas/config.schema.yaml")
    return resolve_config(schema, {"benchmark": values})["benchmark"]


def test_runs_follow_from_the_configuration(project):
    config = section(project, scenes=["stereo_vase", "a/b"], photos=["c/d"], sizes_mp=[0.3])
    runs = benchmark_runs(config, ["cpu", "sgbm"])
    short = [run.removeprefix("results/benchmark/dense/") for run in runs]
    assert short == [
        "stereo_vase/true/full/cpu", "stereo_vase/true/full/sgbm",
        "stereo_vase/sfm/full/cpu", "stereo_vase/sfm/full/sgbm",
        "b/true/full/cpu", "b/true/full/sgbm", "b/sfm/full/cpu", "b/sfm/full/sgbm",
        "d/sfm/full/cpu", "d/sfm/full/sgbm",
        "stereo_vase/true/0.3mp/cpu",
    ]  # fmt: skip
    folders = {name: str(folder) for name, folder in scan_folders(config).items()}
    assert folders == {
        "stereo_vase": "results/benchmark/scenes/stereo_vase",
        "b": "a/b",
        "d": "c/d",
    }
    assert (megapixels_of("full"), megapixels_of("0.3mp")) == (0.0, 0.3)
    with pytest.raises(StageError, match="'b'"):
        scan_folders(section(project, scenes=["a/b"], photos=["c/b"]))


def rates(f1):
    one = {"accuracy": f1, "completeness": f1, "completeness_all": f1, "f1": f1}
    return {size: one for size in ("5mm", "10mm", "20mm")}


def test_tables_hold_the_measured_numbers_and_name_what_is_left_out(tmp_path):
    nothing = {"accuracy": None, "completeness": None, "completeness_all": None, "f1": None}
    paths = []
    for backend, f1, cost in (("cpu", 0.912, 5.26), ("sgbm", 0.634, 3.125)):
        for size in ("full", "0.3mp"):
            folder = tmp_path / "vase" / "true" / size / backend
            measured = {
                "scan": "vase", "cameras": "true", "backend": backend, "n_photos": 40,
                "megapixels": 48.0, "megapixels_per_photo": 1.2, "cpu_s_per_megapixel": cost,
                "fusion_cpu_s_per_megapixel": 0.2, "wall_s_per_megapixel": 2.5,
                "depth": {"cpu_s": 240.0, "peak_mb": 700.0}, "fusion": {"peak_mb": 800.0},
                "agreement": {"share": 0.871, "share_where_known": 0.95},
                "threads": 2, "processor": "Some CPU", "pycolmap": "4.2",
            }  # fmt: skip
            scores = {name: rates(f1) for name in ("all", "thinned", "wood_30mm", *CLASSES)}
            scores["branch_30mm"] = {size: nothing for size in ("5mm", "10mm", "20mm")}
            write_json(folder / "measurement.json", measured)
            write_json(folder / "scores.json", scores)
            paths.append(folder / "measurement.json")
    table = write_table(read_results(paths), ["cuda"])
    assert "CUDA (COLMAP) is left out: this pycolmap has no CUDA." in table
    lines = table.splitlines()
    ours = [line for line in lines if line.startswith("| vase | true | CPU (ours)")]
    assert len(ours) == 1 + 1 + 3  # cost, scores, three tolerances by wood
    assert "| 5.3 |" in ours[0]
    assert "87.1 %" in ours[0]
    assert "**0.912**" in ours[1]
    assert "none" in ours[2]
    tables = [line.count("|") for line in lines if line.startswith("|")]
    assert len(set(tables)) == 4
    with pytest.raises(StageError, match="nothing was measured"):
        read_results([])


@pytest.fixture
def run(tmp_path):
    made = Run(tmp_path / "work")
    made.add_cloud("a")
    made.table("tree | cloud", "a | a.ply")
    return made


def test_the_rules_plan_every_run(run):
    run.configure({"benchmark": {"scenes": ["stereo_vase"], "backends": ["cpu", "sgbm"]}})
    printed = run.run("--dry-run", "benchmark_dense")
    counts = dict(
        line.split()
        for line in printed.split("Job stats:")[1].splitlines()
        if len(line.split()) == 2
    )
    assert counts["render_benchmark_scene"] == "1"
    assert counts["place_benchmark_cameras"] == "2"
    assert counts["measure_stereo"] == counts["score_surface"] == "6"
    assert counts["report_benchmark"] == "1"


def test_a_scene_that_is_not_rendered_says_how(run):
    run.configure({"benchmark": {"scenes": ["stereo_vase"]}})
    printed = run.run("results/benchmark/scenes/stereo_vase/rendered.json", fails=True)
    assert "benchmark.blender_python" in printed
    assert "render_scene.py --preset stereo_vase" in printed
