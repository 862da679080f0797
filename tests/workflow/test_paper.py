"""Every row of docs/paper.md is run: its key changes what the stage leaves, its equation holds."""

import re
import shutil
from functools import cache
from types import SimpleNamespace as Stand

import networkx as nx
import numpy as np
import pytest
import torch
from marker_scene import marker_scan, square
from scan_scene import ground_points, look_at_poses, ring, tree_points
from scipy.sparse import diags
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist, squareform
from skeleton_shapes import labelled_cloud, small_tree, stacked_least_squares, tube
from stage_run import SCHEMA, run_stage
from torch_geometric.nn import EdgeConv
from workspace import PROJECT

from cherrypicker.batch.config import config_notes, lookup, resolve_config
from cherrypicker.classes import CLASS_IDS
from cherrypicker.contraction.contract_points import SkeletonOptions, contract_points
from cherrypicker.contraction.laplacian_published import (
    cotangent_laplacian,
    semantic_row_weights,
    solve_contraction,
)
from cherrypicker.denoising.denoise import neighbor_means, statistical_filter
from cherrypicker.files import read_json, write_json
from cherrypicker.geometry.directions import rodrigues
from cherrypicker.geometry.lines import intersect_rays
from cherrypicker.geometry.sampling import farthest_point_sample
from cherrypicker.graph.spanning_tree import spanning_tree
from cherrypicker.limbs.files import write_orchard
from cherrypicker.limbs.orchard import grow_orchard
from cherrypicker.markers.detection import Reads
from cherrypicker.markers.layouts import Sightings
from cherrypicker.markers.marker_scales import measure_marker
from cherrypicker.markers.scan import Scan
from cherrypicker.pointcloud import PointCloud, read_cloud, write_cloud
from cherrypicker.poses import write_poses
from cherrypicker.segmentation.dgcnn import LinearEdgeConv, nearest_features
from cherrypicker.skeleton import fold, read_skeleton
from cherrypicker.sky import colors as sky_colors
from cherrypicker.sky.colors import SkyColors, cluster_sky_colors, write_sky_colors
from cherrypicker_lab.orchard import skeleton_set
from cherrypicker_lab.skeletons.distances import chamfer_cm2

PAGE = (PROJECT / "docs/paper.md").read_text(encoding="utf-8")


def rows_of(title):
    """Cells of each row of a section's table."""
    body = re.search(rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE, re.M | re.S)[1]
    rows = [line for line in body.splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in row.strip("|").split(" | ")] for row in rows]


def checks_of(title):
    """What a section's rows are run by, each once."""
    return list(dict.fromkeys(row[-1].strip("` ") for row in rows_of(title)))


def setting(key, value, **sections):
    section, name = key.split(".")
    return resolve_config(SCHEMA, {**sections, section: {**sections.get(section, {}), name: value}})


class Scene:
    """The files that stages read, made when they are asked for."""

    def __init__(self, folder, monkeypatch):
        self.folder, self.monkeypatch, self.runs = folder, monkeypatch, 0

    def out(self, name):
        """A new file to write."""
        self.runs += 1
        return str(self.folder / f"{self.runs}_{name}")

    def patch(self, stage, **functions):
        for name, function in functions.items():
            self.monkeypatch.setattr(f"{stage}.{name}", function)


# A key's run: the stage with a config, and what it leaves


def align(scene, settings):
    """A slope, a wall larger than it, a valley heavier than the tree."""
    rng = np.random.default_rng(8)
    ground, centers = ground_points(rng), ring()
    for part in (ground, centers):
        part[:, 2] += np.tan(np.radians(8)) * part[:, 0]
    wall = np.column_stack(
        [rng.uniform(-6, 6, 90_000), np.full(90_000, 4.0), rng.uniform(0, 5, 90_000)]
    )
    valley = rng.uniform((6, -3, -15), (9, 3, -14), (30_000, 3))
    points = np.concatenate([ground, tree_points(rng), wall, valley])
    cloud, poses, out = (scene.out(name) for name in ("c.ply", "p.npz", "a.npz"))
    write_cloud(cloud, PointCloud(points))
    write_poses(poses, look_at_poses(centers, np.array([0.0, 0.0, 1.2])))
    files = {"aligned": scene.out("a.ply"), "aligned_poses": out, "report": scene.out("a.json")}
    run_stage("align_cloud", settings, cloud=cloud, poses=poses, photos=[], **files)
    report = read_json(files["report"])
    return np.round(report["transform"], 6).tolist()


def crop(scene, settings):
    cloud, poses, report = (scene.out(name) for name in ("c.ply", "p.npz", "c.json"))
    write_cloud(cloud, PointCloud(ground_points(np.random.default_rng(0))))
    write_poses(poses, look_at_poses(ring(arc_deg=200), np.array([0.0, 0.0, 1.2])))
    files = {"cropped": scene.out("cropped.ply"), "report": report}
    run_stage("crop_roi", settings, cloud=cloud, poses=poses, **files)
    return read_json(report)["n_kept"]


def denoise(scene, settings):
    """Isolated, poorly seen and white points, half of them before the sky in the photos."""
    rng = np.random.default_rng(1)
    wood, far = rng.normal(0, 0.1, (2900, 3)), rng.uniform(-1.5, 1.5, (200, 3))
    clump = rng.normal((-1, 0, 0.5), 0.01, (100, 3))
    seen = np.repeat(np.array([9, 1, 9], np.uint8), [2900, 100, 200])
    colors = np.full((3200, 3), 0.3)
    colors[:400] = 0.9
    cloud, out, sky, poses = (scene.out(name) for name in ("c.ply", "d.ply", "s.npz", "p.npz"))
    points = np.vstack([wood, clump, far])
    write_cloud(cloud, PointCloud(points, colors, fields={"n_views": seen}))
    write_poses(poses, look_at_poses(ring(), np.array([0.0, 0.0, 1.2])))
    white = np.full((1, 3), 0.9, np.float32)
    write_sky_colors(sky, SkyColors(white, np.zeros(1, np.int32), np.ones(1), 100))

    def ask(photos, asked, sure, *, seed):
        return np.where((asked[:, 0] > 0) | (asked[:, 0] < -0.9), -9.0, 9.0)

    scene.patch("denoise_cloud", ask_points=ask, ScanPhotos=lambda *given: None)
    files = {"cameras": poses, "evidence": "e", "sky_colors": sky}
    files |= {"denoised": out, "report": scene.out("d.json"), "removed": scene.out("d.npz")}
    run_stage("denoise_cloud", settings, cloud=cloud, poses=poses, **files)
    return read_cloud(out).points.tobytes()


def scale(scene, settings):
    poses = look_at_poses(ring(6, radius=2.2, heights=(1.2, 1.8)), np.array([0.0, 0.0, 0.1]))
    markers = [("DICT_4X4_50", 7, square([0.25, -0.1, 0.05], 0.25, normal=(0.1, 0.0, 1)))]
    folder = scene.folder / "markers"
    folder.mkdir(exist_ok=True)
    photos, model = marker_scan(folder, markers, poses)
    scene.patch("estimate_scale", read_model=lambda path: model)
    out = scene.out("scale.json")
    named = {"dictionary": "DICT_4X4_50", "sides_m": "7:0.25"}
    files = {"cameras": "m/cameras.bin", "scale": out, "photos": list(map(str, photos))}
    run_stage("estimate_scale", settings, **files, **named)
    return read_json(out)["scale"]


def segment(scene, settings):
    points, _, _ = small_tree(noise=0.002)
    ground = ground_points(np.random.default_rng(2), reach=1.0, n=8000)
    cloud, out = scene.out("m.ply"), scene.out("s.ply")
    colors = np.repeat([[0.4, 0.3, 0.2], [0.3, 0.5, 0.2]], [len(points), len(ground)], axis=0)
    write_cloud(cloud, PointCloud(np.vstack([points, ground]), colors, frame="metric", unit="m"))
    run_stage("segment_cloud", settings, cloud=cloud, segmented=out, limbs=scene.out("l.npz"))
    return read_cloud(out)["label"].tobytes()


@cache
def tree_with_strays(every=4):
    """A tree, in line with its top a string of stray points; and its limbs, grown once."""
    points, labels, _ = small_tree(noise=0.002)
    points, labels = points[::every], labels[::every]
    stray = np.column_stack([np.zeros((8, 2)), 1.23 + 0.03 * np.arange(8)])
    cloud = labelled_cloud(np.vstack([points, stray]), np.append(labels, np.full(8, 2)))
    return cloud, grow_orchard(cloud)


def select(scene, settings):
    """The wood that is chosen and thinned; its limbs are grown in the stage."""
    return contract(scene, settings, has_limbs=False)


def leave_out(scene, settings):
    """As `select`, of a cloud with many points a voxel."""
    wide = {**settings, "contract": {**settings["contract"], "voxel_size_m": 0.015}}
    return contract(scene, wide, has_limbs=False, every=1)


def contract(scene, settings, *, has_limbs=True, every=4):
    cloud, orchard = tree_with_strays(every)
    segmented, out = scene.out("s.ply"), scene.out("c.ply")
    write_cloud(segmented, cloud)
    files = {"report": scene.out("c.json"), "target": scene.out("t.json")}
    files |= {"removed": scene.out("r.ply")}
    if has_limbs:
        files["limbs"] = scene.out("limbs.npz")
        write_orchard(files["limbs"], orchard)
    run_stage("contract_cloud", settings, segmented=segmented, contracted=out, **files)
    return read_cloud(out).points.tobytes()


def graph(scene, settings, **files):
    """The skeleton of a tree, of which the photos refute the last branch."""
    cloud, orchard = tree_with_strays()
    report, limbs = scene.out("c.json"), scene.out("limbs.npz")
    segmented, contracted, out = (scene.out(name) for name in ("s.ply", "c.ply", "s.graphml"))
    rows = orchard.entered[0]
    fields = {"label": cloud["label"][rows], "source": rows.astype(np.int32)}
    write_cloud(segmented, cloud)
    write_cloud(contracted, PointCloud(cloud.points[rows], fields=fields, frame="metric", unit="m"))
    write_json(report, {"stem": 0, "base": orchard.bases[0]})
    write_orchard(limbs, orchard)

    def half(skeleton, *given, **named):
        return skeleton.select(np.arange(len(skeleton)) < len(skeleton) // 2), []

    def nothing(*given, **named):
        return None

    scene.patch("extract_graph", drop=half, ScanPhotos=nothing, read_poses=nothing)
    photos = dict.fromkeys(("cameras", "metric_poses", "evidence"), "m/x")
    files = {"contracted": contracted, "segmented": segmented, **photos, **files}
    files |= {"contract_report": report, "limbs": limbs}
    run_stage("extract_graph", settings, skeleton_graph=out, **files)
    return read_skeleton(out).points.tobytes()


def sky(scene, settings):
    """One photo of the demo."""
    photo = sorted((PROJECT / "resources/demo/cherry_vase/photos").iterdir())[0]
    folder, masks = scene.folder / "photo", scene.folder / f"masks_{scene.runs}"
    folder.mkdir(exist_ok=True)
    shutil.copy(photo, folder)
    run_stage("segment_sky", settings, photo_folder=str(folder), masks=str(masks),
              colors=scene.out("c.npz"), threads=1)  # fmt: skip
    return next(masks.glob("*.png")).read_bytes()


class Taken(Exception):
    """What a stage handed to the library."""


def taken(*given, **named):
    raise Taken(repr(given) + repr(named))


def fuse(scene, settings):
    """The options that reach the fusion, whether silhouettes are added, and what ground stays."""
    said, none = [], Stand(points=np.zeros((0, 3)))
    none.select = lambda keep: none
    region = Stand(holds=lambda points: slice(None))
    scene.patch(
        "fuse_depth",
        read_json=lambda path: {"maps": []},
        ScanPhotos=lambda *a, **k: None,
        Workspace=lambda *a, **k: Stand(region=region, poses=None),
        read_poses=lambda path: None,
        fuse_workspace=lambda w, names, options, **named: said.append((options, named)) or none,
        words_of_clear_sky=lambda *a, **k: None,
        measure_coverage=lambda *a: {},
        add_silhouettes=lambda *a, **k: said.append("silhouettes") or none,
        needed_points=lambda points, poses, region, spacing, **k: said.append(spacing),
        write_cloud=lambda *a: None,
    )  # fmt: skip
    files = {
        "images": "d/images",
        "sparse": "d/sparse",
        "maps": "d/stereo",
        "report": "d/depth.json",
    }
    files |= {"cameras": "p", "depth": "d", "evidence": "e", "cloud": "c"}
    run_stage("fuse_depth", settings, **files, coverage=scene.out("coverage.json"))
    return repr(said)


def train_sky(scene, settings):
    scene.patch("train_sky", load_photos=lambda *a: [], split_photos=lambda *a: ([], []),
                train_network=taken)  # fmt: skip
    changed = {**settings, "train_sky": {**settings["train_sky"], "folders": ["x"]}}
    with pytest.raises(Taken) as caught:
        run_stage("train_sky", changed, weights=str(scene.folder / "w"), metrics="m")
    return str(caught.value)


def train_segment(scene, settings):
    scene.patch("train_segmentation", load_samples=lambda *a: [], train=taken)
    with pytest.raises(Taken) as caught:
        run_stage("train_segmentation", settings, weights="w", metrics="m", workspace="w")
    return str(caught.value)


RUN_OF = {
    "align": align,
    "crop": crop,
    "denoise": denoise,
    "sky": sky,
    "scale": scale,
    "segment": segment,
    "contract": select,
    "contract.min_density": leave_out,
    "mvs": fuse,
    "skeleton": contract,
    "photo_check": graph,
    "train_sky": train_sky,
    "train_segment": train_segment,
}


@pytest.fixture
def scene(tmp_path, monkeypatch):
    return Scene(tmp_path, monkeypatch)


def test_every_key_that_the_method_changes_has_a_row():
    changed = {
        f"{section}.{name}"
        for section, keys in SCHEMA["properties"].items()
        for name, each in keys.get("properties", {}).items()
        if "paper" in each
    }
    assert len(rows_of("Keys")) == len(checks_of("Keys"))
    assert set(checks_of("Keys")) == changed


@pytest.mark.parametrize("key", checks_of("Keys"))
def test_a_row_of_keys(key, scene):
    (row,) = [row for row in rows_of("Keys") if row[-1].strip("` ") == key]
    values = re.findall(r"`([^`]+)`", row[1])
    plain, paper = (lookup(resolve_config(SCHEMA, c), key) for c in ({}, {"method": "paper"}))
    assert values == [str(plain), str(paper)], "the page's values are the schema's"
    for path in re.findall(r"`([\w/.]+)`", row[2]):
        folders = ("scripts/cherrypicker", "scripts/cherrypicker_lab")
        assert any((PROJECT / folder / path).exists() for folder in folders), path
    run = RUN_OF.get(key) or RUN_OF[key.split(".")[0]]
    assert run(scene, setting(key, plain)) != run(scene, setting(key, paper)), f"{key} does nothing"


def rolled(points):
    """The rows of a contracted cloud's points in another order: garbage, of the same extent."""
    return points[np.random.default_rng(0).permutation(len(points))]


@pytest.mark.parametrize("method", ["limbs", "slbc", "lbc"])
def test_the_graph_is_of_the_contracted_points_but_for_limbs(method, scene):
    """As the page says; the photos have no say here."""
    settings = resolve_config(
        SCHEMA, {"skeleton": {"method": method}, "photo_check": {"drop_refuted": False}}
    )
    whole = graph(scene, settings)
    garbage = read_cloud(scene.folder / f"{scene.runs - 1}_c.ply", required=("label", "source"))
    garbage.points[:] = rolled(garbage.points) * [1, 1, 0.5]
    path = scene.out("garbage.ply")
    write_cloud(path, garbage)
    assert (graph(scene, settings, contracted=path) == whole) == (method == "limbs")


def test_weights_by_class_are_read_by_slbc_alone(scene):
    few = {"max_iterations": 2}
    for method, is_read in (("slbc", True), ("lbc", False), ("limbs", False)):
        found = {
            contract(scene, setting("skeleton.weights", weights, skeleton=few | {"method": method}))
            for weights in ({}, {"trunk": 3}, {"branch": 4})
        }
        assert len(found) == (3 if is_read else 1), method


CONSTANTS = {
    "initial_contraction": 100,
    "initial_attraction": 2,
    "attraction_rule": "cao",
    "amplification": 4,
    "max_contraction": 20,
    "max_attraction": 2,
    "min_weight": 0.7,
    "termination_ratio": 0.5,
    "max_iterations": 2,
    "n_neighbors": 12,
    "mollify_factor": 0.01,
}


@pytest.mark.parametrize("name", CONSTANTS)
def test_each_constant_of_the_contraction_is_read(name, scene):
    assert set(CONSTANTS) == set(SCHEMA["properties"]["skeleton"]["properties"]) - {
        "method",
        "weights",
    }
    given = {"method": "lbc", "max_iterations": 3}
    plain = contract(scene, resolve_config(SCHEMA, {"skeleton": given}))
    key = f"skeleton.{name}"
    assert contract(scene, setting(key, CONSTANTS[name], skeleton=given)) != plain
    in_vain = {"skeleton": {"method": "limbs", name: CONSTANTS[name]}}
    (note,) = config_notes(SCHEMA, in_vain)
    assert f"{key}: {CONSTANTS[name]} does nothing" in note


# Equations


def check_rodrigues(rng):
    for source in rng.normal(size=(5, 3)):
        rotation = rodrigues(source)
        turned = rotation @ source / np.linalg.norm(source)
        np.testing.assert_allclose(turned, [0.0, 0.0, 1.0], atol=1e-12)
        axis = np.cross(source, [0.0, 0.0, 1.0])  # the smallest turn is about it
        np.testing.assert_allclose(rotation @ axis, axis, atol=1e-12)


def check_sky_colours(rng):
    assert sky_colors.JITTER == 1 / 256 and sky_colors.DBSCAN.__module__.startswith("sklearn")
    blue, white = rng.normal((90, 140, 220), 2, (2000, 3)), rng.normal(240, 2, (1000, 3))
    samples = np.vstack([blue, white]).clip(0, 255).astype(np.uint8)
    found = cluster_sky_colors(samples, seed=0)
    np.testing.assert_allclose(found.fraction, [2 / 3, 1 / 3], atol=0.02)


def check_statistical_filter(rng):
    points = np.vstack([rng.normal(0, 0.1, (500, 3)), rng.uniform(-2, 2, (20, 3))])
    mean, _ = neighbor_means(points, np.zeros(520), 20)
    kept = mean < mean.mean() + 2 * mean.std(ddof=1)
    np.testing.assert_array_equal(statistical_filter(points, 20, 2.0), kept)


def observed(rng, corners, noise_px=0.0):
    poses = look_at_poses(ring(8, radius=2.5), np.array([0.0, 0.0, 0.3]))
    seen = np.einsum("nij,kj->nki", poses.rotations, corners) + poses.cam_from_world[:, None, :, 3]
    seen = seen[..., :2] / seen[..., 2:] + rng.normal(0, noise_px / 1000, (8, 4, 2))
    ones = np.ones(8)
    return poses, Sightings(
        photos=np.arange(8), cam_from_world=poses.cam_from_world, places=seen,
        focal=1000 * ones, std=0.1 * ones, side_px=60 * ones,
    )  # fmt: skip


def check_rays(rng):
    corners = square([0.3, 0.2, 0.0], 0.2)
    poses, seen = observed(rng, corners)
    pixels = np.dstack([seen.places, np.ones((8, 4))]) @ poses.K[0].T
    camera_rays = pixels @ np.linalg.inv(poses.K[0]).T
    u = np.einsum("nji,nkj->nki", poses.rotations, camera_rays)
    u /= np.linalg.norm(u, axis=2, keepdims=True)
    np.testing.assert_allclose(seen.rays, u, atol=1e-12)
    along = np.einsum("nki,nki->nk", corners - poses.centers[:, None], u)
    reached = poses.centers[:, None] + along[..., None] * u
    np.testing.assert_allclose(reached, np.repeat(corners[None], 8, axis=0), atol=1e-9)


def check_objective(rng):
    t, u = rng.normal(size=(6, 3)), rng.normal(size=(6, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)

    def distance(x):
        return sum(np.sum(((a - x) - ((a - x) @ b) * b) ** 2) for a, b in zip(t, u))

    x = intersect_rays(t, u)
    assert all(distance(x) < distance(x + step) for step in rng.normal(0, 1e-3, (50, 3)))


def check_scale_factor(rng):
    corners = square([0.3, 0.2, 0.0], 0.2)
    poses, seen = observed(rng, corners, 0.3)
    every = np.ones(8, bool)
    told = {"dictionaries": every, "ids": 7 * every, "is_matched": every, "is_precise": every}
    scan = Scan([], [], poses.cam_from_world, side="mean")
    found = measure_marker("", 7, 0.25, Reads(**vars(seen), **told), scan)
    x = np.array(found["corners"])
    d_scene = np.mean([np.linalg.norm(x[i] - x[(i + 1) % 4]) for i in range(4)])
    assert found["scale"] == pytest.approx(0.25 / d_scene)


def check_edgeconv(rng):
    torch.manual_seed(0)
    conv, x = LinearEdgeConv(4, 6), torch.randn(30, 4)
    neighbors = nearest_features(x, [30], 5)
    edges = torch.stack([neighbors.reshape(-1).long(), torch.arange(30).repeat_interleave(5)])
    assert torch.allclose(conv(x, neighbors), EdgeConv.forward(conv, x, edges), atol=1e-5)


def check_lbc(rng):
    points = rng.random((40, 3))
    L, _ = cotangent_laplacian(points, n_neighbors=12)
    w_l, w_h = rng.random(40) + 0.5, rng.random(40) + 0.5
    expected = stacked_least_squares(L, w_l, w_h, points)
    np.testing.assert_allclose(solve_contraction(L, w_l, w_h, points), expected, atol=1e-8)


def stem(rng, n=900):
    points = tube((0, 0, 0), (0, 0, 0.5), 0.04, 60_000, rng=rng)
    return points[np.sort(rng.choice(len(points), n, False))]


def check_iteration(rng):
    """Two iterations by hand: W_L grows by the amplification, W_H by the area that is lost."""
    points = stem(rng)
    points -= points.mean(axis=0)
    options = SkeletonOptions("lbc", max_iterations=2, amplification=3.0, n_neighbors=20)
    L, M = cotangent_laplacian(points, n_neighbors=20)
    w_l, w_h = 1000 * np.sqrt(M.mean()), np.full(len(points), 0.5)
    first = solve_contraction(L, w_l * np.ones(len(points)), w_h, points)
    L, now = cotangent_laplacian(first, n_neighbors=20)
    w_h = np.clip(w_h * np.sqrt(M / now), 0.1, 1024)
    w_l = np.clip(3 * w_l, 0.1, 2048)
    second = solve_contraction(L, w_l * np.ones(len(points)), w_h, first)
    result = contract_points(points, None, options)
    np.testing.assert_allclose(result.points, second, atol=1e-9)
    stopped = contract_points(points, None, SkeletonOptions("lbc", termination_ratio=1.0))
    assert len(stopped.mass_ratio) == 1 and "mass ratio below 1" in stopped.stop


def check_weights(rng):
    """Of two classes as published; of three, the smallest around."""
    points = rng.random((200, 3))
    L, _ = cotangent_laplacian(points, n_neighbors=8)
    is_trunk = points[:, 0] < 0.5
    found = semantic_row_weights(L, np.where(is_trunk, 10.0, 1.0))
    for row in range(200):
        around = L.indices[L.indptr[row] : L.indptr[row + 1]]
        assert found[row] == (10 if is_trunk[row] and is_trunk[around].all() else 1)
    lambdas = np.select([points[:, 0] < 0.3, points[:, 0] < 0.6], [10.0, 5.0], 2.0)
    found = semantic_row_weights(L, lambdas)
    rows = [L.indices[L.indptr[row] : L.indptr[row + 1]] for row in range(200)]
    np.testing.assert_array_equal(found, [lambdas[around].min() for around in rows])


def check_s_lbc(rng):
    """S weighs the rows of the upper block."""
    points = stem(rng)
    points -= points.mean(axis=0)
    lambdas = np.where(points[:, 2] < 0, 10.0, 1.0)
    L, M = cotangent_laplacian(points, n_neighbors=20)
    S = diags(semantic_row_weights(L, lambdas))
    w_l = 1000 * np.sqrt(M.mean())
    A = np.vstack([(S @ (w_l * L)).toarray(), 0.5 * np.eye(len(points))])
    b = np.vstack([np.zeros_like(points), 0.5 * points])
    expected = np.linalg.lstsq(A, b, rcond=None)[0]
    options = SkeletonOptions("slbc", max_iterations=1, n_neighbors=20)
    np.testing.assert_allclose(
        contract_points(points, lambdas, options).points, expected, atol=1e-7
    )


def check_farthest_points(rng):
    points = rng.random((500, 3))
    samples, _ = farthest_point_sample(points, 0.2, first=3)
    assert samples[0] == 3
    assert cKDTree(points[samples]).query(points)[0].max() <= 0.2
    for number in range(1, len(samples)):  # each the farthest from those before it
        away = cKDTree(points[samples[:number]]).query(points)[0]
        assert away[samples[number]] == pytest.approx(away.max())


def check_spanning_tree(rng):
    """As light as the minimum spanning tree of all pairs."""
    points, labels, _ = small_tree()
    skeleton = spanning_tree(points, labels, spacing_m=0.03)
    whole = nx.from_numpy_array(squareform(pdist(skeleton.points)))
    lightest = nx.minimum_spanning_tree(whole).size("weight")
    assert skeleton.edge_length.sum() == pytest.approx(lightest, rel=1e-9)


def check_folding(rng):
    points, labels, _ = small_tree()
    skeleton = spanning_tree(points, labels, spacing_m=0.03)
    graph = fold(skeleton)
    degrees = dict(graph.degree)
    assert {node for node, degree in degrees.items() if degree == 2} <= {0}
    assert graph.size("length") == pytest.approx(skeleton.edge_length.sum())
    kept = {node for node, degree in enumerate(skeleton.degree) if degree != 2 or node == 0}
    assert set(graph) == kept


def check_chamfer(rng):
    x, y = rng.random((30, 3)), rng.random((40, 3))
    apart = np.sum((x[:, None] - y[None]) ** 2, axis=2)
    expected = apart.min(axis=1).mean() + apart.min(axis=0).mean()
    assert chamfer_cm2(x, y) == pytest.approx(1e4 * expected)


EQUATIONS = {
    name.removeprefix("check_").replace("_", " "): check
    for name, check in list(globals().items())
    if name.startswith("check_")
} | {"s-lbc": check_s_lbc}
del EQUATIONS["s lbc"]


@pytest.mark.parametrize("name", checks_of("Equations"))
def test_a_row_of_equations(name):
    EQUATIONS[name](np.random.default_rng(5))


def test_every_equation_has_a_row():
    assert set(EQUATIONS) == set(checks_of("Equations"))
    for row in rows_of("Equations"):
        path, _, name = row[1].strip("`").partition(": ")
        folder = "scripts" if path.startswith("cherrypicker_lab") else "scripts/cherrypicker"
        file = PROJECT / folder / path
        assert file.is_file() and (
            not name or re.search(rf"(def|class) {name}\b", file.read_text())
        )


@pytest.mark.parametrize("text", checks_of("Parameters"))
def test_a_row_of_parameters(text):
    settings = resolve_config(SCHEMA, {"method": "paper"})
    if text == "classes":
        of_the_paper = ["ground", "trunk", "branch", "sign", "marker", "calibration_unit", "roof"]
        assert [CLASS_IDS[name] for name in of_the_paper] == list(range(7))
        assert CLASS_IDS["support_post"] == 7
    elif text == "the set":
        assert (skeleton_set.VOXEL_M, skeleton_set.HOLE_RADIUS_M) == (0.015, 0.08)
        assert skeleton_set.NOISE_M == 3 * skeleton_set.SIGMA_D_M
    else:
        key, value = text.split(" = ")
        found = lookup(settings, key)
        if isinstance(found, dict):
            name, value = value.split()
            found = found[name]
        assert str(found) == value


@pytest.mark.parametrize("name", checks_of("Figures and tables"))
def test_a_row_of_figures(name):
    assert (PROJECT / name).is_file() or name in EQUATIONS


def test_the_example_is_the_method():
    text = (PROJECT / "config/examples/paper.yaml").read_text()
    assert re.findall(r"(?m)^[^#\n].*", text) == ["method: paper"]
