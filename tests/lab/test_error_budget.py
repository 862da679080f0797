"""The error budget: true depth by rays, the truth in a stage's place, what each stage costs."""

import networkx as nx
import numpy as np
import pytest
from scan_scene import look_at_poses

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.files import read_json, write_json
from cherrypicker.pointcloud import PointCloud, read_cloud, write_cloud
from cherrypicker.poses import View, write_poses
from cherrypicker.skeleton import Skeleton, read_skeleton
from cherrypicker_lab import error_budget
from cherrypicker_lab.dense.true_depth import TrueScene, ground_mesh, square_mesh
from cherrypicker_lab.error_budget import (
    RUNGS,
    STAGES,
    climb,
    costs_of,
    dearest,
    errors_of,
    markdown,
)
from cherrypicker_lab.truth_swaps import place_true_labels, place_true_skeleton, take_over

RADIUS, HEIGHT = 0.04, 1.0
#: Turn about z and shift from the tree's metric frame to the scene's.
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
SHIFT = np.array([0.5, -0.2, 0.1])


def stem(n=11):
    """A straight stem of 1 m."""
    points = np.column_stack([np.zeros((n, 2)), np.linspace(0, HEIGHT, n)])
    fields = {"order": np.zeros(n, int)}
    return Skeleton(points, np.arange(n) - 1, np.full(n, RADIUS), np.ones(n, int), fields)


def ring_poses(n=6):
    a = np.linspace(0, 2 * np.pi, n, endpoint=False)
    centers = np.column_stack([2 * np.cos(a), 2 * np.sin(a), 0.5 + 0.3 * np.sin(2 * a)])
    level = centers * [0, 0, 1]
    poses = look_at_poses(centers, level, size=(200, 300), focal=200.0)
    poses.names = np.array([f"{k}.jpg" for k in range(n)])
    return poses


@pytest.fixture
def truth(tmp_path):
    """The truth of a scene: a stem of 4 cm radius on flat ground, a wall 1 m behind it."""
    folder = tmp_path / "scene/truth"
    folder.mkdir(parents=True)
    lines = ["id,parent,x,y,z,radius,order,label"]
    lines += [f"{i},{i - 1},0,0,{z},{RADIUS},0,1" for i, z in enumerate(np.linspace(0, 1, 11))]
    (folder / "skeleton.csv").write_text("\n".join(lines) + "\n")
    grid = np.arange(-1.5, 1.5, 0.04)
    x, y = (a.ravel() for a in np.meshgrid(grid, grid))
    ground = np.column_stack([x, y, np.zeros(len(x))])
    wy, wz = (a.ravel() for a in np.meshgrid(np.arange(-0.5, 0.5, 0.02), np.arange(0, 1, 0.02)))
    wall = np.column_stack([np.full(len(wy), -1.0), wy, wz])
    label = np.r_[np.full(len(ground), Label.GROUND), np.full(len(wall), Label.SIGN)]
    fields = {"label": label.astype(np.uint8), "tree": np.full(len(label), 255, np.uint8)}
    cloud = PointCloud(np.vstack([ground, wall]), fields=fields, frame="metric", unit="m")
    write_cloud(folder / "cloud.ply", cloud)
    write_poses(folder / "poses.npz", ring_poses())
    traits = {"trunk_diameter_m": 0.08, "height_m": 1.0, "total_length_m": 1.0}
    write_json(folder / "traits.json", traits)
    return folder


@pytest.fixture
def results(tmp_path):
    """A tree's results up to metric.ply, in a frame of their own."""
    folder = tmp_path / "results/tree"
    (folder / "sfm").mkdir(parents=True)
    rng = np.random.default_rng(0)
    angle, z = rng.uniform(0, 2 * np.pi, 400), rng.uniform(0.05, 0.95, 400)
    bark = np.column_stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), z])
    ground = np.column_stack([rng.uniform(0.3, 1, (100, 2)), np.full(100, 0.005)])
    floating = np.array([[0.3, 0.3, 0.7]])
    points = (np.vstack([bark, ground, floating]) - SHIFT) @ TURN
    write_cloud(folder / "metric.ply", PointCloud(points, frame="metric", unit="m"))
    poses = ring_poses().transformed(1.0, TURN.T, -TURN.T @ SHIFT)
    write_poses(folder / "metric_poses.npz", poses)
    write_json(folder / "metric.json", {"unit": "m"})
    for name in ("sfm/report.json", "scale.json", "crop.json"):
        write_json(folder / name, {"name": name})
    return folder


def view_from_x(x=2.0):
    """A camera at (x, 0, 0.5) that looks along -x."""
    R = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    K = np.array([[300.0, 0, 150], [0, 300, 150], [0, 0, 1]])
    return View("a.jpg", K, R, -R @ np.array([x, 0, 0.5]), 300, 300)


def test_true_depth_of_a_stem_the_wall_behind_it_and_the_ground(truth):
    depth, normals = TrueScene(truth).depth(view_from_x(), 1)
    rows, columns = np.array([100, 150, 200]), 150
    offset = (0.5 / 300) * 2.0  # the ray half a pixel beside the axis
    exact = 2.0 - np.sqrt(RADIUS**2 - offset**2)
    assert depth[rows, columns] == pytest.approx(exact, abs=0.0006)  # a facet's sagitta
    assert normals[150, columns] == pytest.approx([0, 0, -1], abs=0.15)
    assert depth[150, 110] == pytest.approx(3.0, abs=1e-3)  # the wall, past the stem
    assert (normals[120:180, 105:140, 2] < 0).all()
    below = 260 + 0.5 - 150
    assert depth[260, 30] == pytest.approx(0.5 * 300 / below, abs=1e-3)  # the ground
    assert depth[10, 30] == 0 and not normals[10, 30].any()
    # as wide as it is: 8 cm at 2 m
    n_wide = np.count_nonzero((depth[150] > 0) & (depth[150] < 2.5))
    assert n_wide == pytest.approx(300 * 0.08 / 2.0, abs=1.01)


def test_ground_keeps_its_holes_and_squares_their_plane():
    x, y = (a.ravel() for a in np.meshgrid(np.arange(20) * 0.1, np.arange(20) * 0.1))
    points = np.column_stack([x, y, 0.1 * x])
    far = points + [10, 0, 0]
    vertices, faces = ground_mesh(np.vstack([points, far]))
    crossing = (vertices[faces][:, :, 0] > 5).any(axis=1) & (vertices[faces][:, :, 0] < 5).any(
        axis=1
    )
    assert len(faces) > 1000 and not crossing.any()
    corners, faces = square_mesh(points)
    assert corners[:, 2] == pytest.approx(0.1 * corners[:, 0], abs=1e-9)
    assert len(faces) == 2 * len(points)


def test_true_labels_are_those_of_the_surface_that_a_point_lies_on(results, truth, tmp_path):
    there = tmp_path / "rung/results/tree"
    take_over(results, there)
    place_true_labels(there, truth)
    cloud = read_cloud(there / "segmented.ply", required=("label", "confidence"))
    assert (cloud["label"][:400] == Label.TRUNK).all()
    assert (cloud["label"][400:500] == Label.GROUND).all()
    assert cloud["label"][500] == Label.UNLABELLED
    assert read_json(there / "scale.json") == {"name": "scale.json"}


def test_the_true_tree_stands_in_the_trees_frame(results, truth, tmp_path):
    there = tmp_path / "rung"
    take_over(results, there)
    placed = place_true_skeleton(there, truth)
    skeleton = read_skeleton(placed[0])
    moved = skeleton.points @ TURN.T + SHIFT
    assert np.abs(moved[:, :2]).max() < 1e-5
    assert np.ptp(moved[:, 2]) == pytest.approx(HEIGHT, abs=1e-4)
    assert skeleton.radius == pytest.approx(RADIUS)
    assert len(nx.read_graphml(placed[1]).edges) == 1


def test_results_that_are_not_complete_are_named(results, truth, tmp_path):
    (results / "metric.ply").unlink()
    with pytest.raises(StageError, match="missing") as caught:
        take_over(results, tmp_path / "rung")
        place_true_labels(tmp_path / "rung", truth)
    assert "metric.ply" in caught.value.describe()


def test_only_what_the_truth_replaces_is_newer_than_it_was(results, truth, tmp_path):
    there = tmp_path / "rung"
    before = {path.name: path.stat().st_mtime_ns for path in results.rglob("*.*")}
    take_over(results, there)
    placed = place_true_labels(there, truth)
    changed = [p for p in there.rglob("*.*") if before.get(p.name) != p.stat().st_mtime_ns]
    assert changed == placed


def test_without_a_scale_there_is_no_budget(results, truth, tmp_path):
    write_json(results / "metric.json", {"unit": "arbitrary"})
    with pytest.raises(StageError, match="no scale"):
        take_over(results, tmp_path / "rung")
        place_true_labels(tmp_path / "rung", truth)


LADDER = {
    "found": {"recall": 4.0, "recall_all": 10.0, "trunk": 6.0, "length": 12.0},
    "true_poses": {"recall": 3.0, "recall_all": 9.0, "trunk": 2.0, "length": 12.0},
    "true_depth": {"recall": 3.0, "recall_all": 4.0, "trunk": 2.5, "length": 6.0},
    "true_labels": {"recall": 1.0, "recall_all": 3.0, "trunk": 1.0, "length": 5.0},
    "true_skeleton": {"recall": 0.0, "recall_all": 1.0, "trunk": 1.0, "length": 2.0},
}


def test_costs_are_the_steps_of_the_ladder_and_add_up():
    costs = costs_of(LADDER)
    assert list(costs) == list(STAGES)
    assert costs["true_poses"] == {
        "recall": 1, "recall_all": 1, "trunk": 4, "length": 0, "sum": 5
    }  # fmt: skip
    assert costs["true_depth"]["trunk"] == -0.5
    assert costs["rest"]["sum"] == 4
    for name, whole in LADDER["found"].items():
        assert sum(cost[name] for cost in costs.values()) == pytest.approx(whole)
    assert dearest(costs) == "true_depth" and dearest(costs, "trunk") == "true_poses"


def test_errors_are_percent_of_the_truth():
    report = {
        "skeleton_recall": 0.97,
        "skeleton_recall_all": 0.9,
        "trunk_diameter_error_m": 0.002,
        "total_length_m_ratio": 0.8,
    }
    errors = errors_of(report, {"trunk_diameter_m": 0.08})
    assert errors == pytest.approx({"recall": 3, "recall_all": 10, "trunk": 2.5, "length": 20})


def test_the_table_names_the_dearest_stage():
    costs = costs_of(LADDER)
    text = markdown({"tree": {"ladder": LADDER, "costs": costs, "dearest": dearest(costs)}})
    assert "| + true depth | 3.00 | 4.00 | 2.50 | 6.00 |" in text
    assert "| **depth (stereo)** | +0.00 | +5.00 | -0.50 | +6.00 | +10.50 |" in text
    assert "Costs most: depth (stereo)." in text


def test_climbing_runs_the_stages_after_each_swap(truth, tmp_path, monkeypatch):
    """Each rung builds on the one before, in a folder with the tree's own row and settings."""
    calls = []
    swaps = ("place_true_poses", "place_true_depth", "place_true_labels", "place_true_skeleton")
    for name in swaps:
        monkeypatch.setattr(
            error_budget, name, lambda here, *_, _n=name, **__: calls.append((_n, here)) or []
        )
    taken = []
    monkeypatch.setattr(error_budget, "take_over", lambda *both: taken.append(both))
    ran = []
    monkeypatch.setattr(error_budget, "run_stages", lambda _s, folder, *_: ran.append(folder))
    values = {
        "skeleton_recall": 1.0,
        "skeleton_recall_all": 1.0,
        "trunk_diameter_error_m": 0.0,
        "total_length_m_ratio": 1.0,
    }
    monkeypatch.setattr(error_budget, "evaluate", lambda *_: values)
    settings = {"seed": 0, "sky": {"weights": ""}, "segment": {"weights": "w.pt"}, "trees": "x"}
    found, folder = tmp_path / "results/tree", tmp_path / "budget"
    report = climb(
        found,
        truth,
        folder,
        tree="tree",
        row={"photos": "photos", "marker_sides_m": "7:0.2"},
        settings=settings,
        snakefile=tmp_path / "Snakefile",
        threads=1,
    )
    rungs = [folder / rung / "results/tree" for rung in RUNGS[1:]]
    assert calls == list(zip(swaps, rungs, strict=True))
    assert taken == list(zip([found, *rungs[:-1]], rungs, strict=True))
    assert ran == [folder / rung for rung in RUNGS[1:]]
    assert report["costs"]["rest"]["sum"] == 0
    header, cells = (folder / "true_depth/config/trees.tsv").read_text().splitlines()
    row = dict(zip(header.split("\t"), cells.split("\t")))
    assert row["tree"] == "tree" and row["marker_sides_m"] == "7:0.2"
    assert row["photos"].startswith("/")


def test_a_rung_whose_truth_is_made_anew_is_no_rung(results, truth, tmp_path, monkeypatch):
    def run_all(_snakefile, folder, *_):
        (folder / "results/tree/poses.npz").write_bytes(b"found again")

    def place(here, *_, **__):
        (here / "poses.npz").write_bytes(b"true")
        return [here / "poses.npz"]

    monkeypatch.setattr(error_budget, "place_true_poses", place)
    monkeypatch.setattr(error_budget, "run_stages", run_all)
    monkeypatch.setattr(error_budget, "evaluate", lambda *_: {})
    with pytest.raises(StageError, match="overwrote the truth"):
        climb(
            results,
            truth,
            tmp_path / "budget",
            tree="tree",
            row={"photos": "photos"},
            settings={"seed": 0, "sky": {}, "segment": {}},
            snakefile=tmp_path / "Snakefile",
            threads=1,
        )
