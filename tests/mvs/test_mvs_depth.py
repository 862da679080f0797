"""Depth maps and fusion of ray traced scenes whose depth is known."""

import os
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
import yaml
from stereo_scene import Surface, write_scene

from cherrypicker.batch.resources import ScanSize
from cherrypicker.errors import StageError
from cherrypicker.mvs.backends.choice import estimate_workspace
from cherrypicker.mvs.backends.table import BACKENDS, Backend, first_choice
from cherrypicker.mvs.estimate import Stereo, StereoOptions, field_to_maps, maps_to_field
from cherrypicker.mvs.fusion import FusionOptions, fuse_workspace
from cherrypicker.mvs.kernels.matching import noise_variance
from cherrypicker.mvs.views import plan_views
from cherrypicker.mvs.workspace import Workspace

SLANTED = Surface(normal=(-0.5, 0.2, 1.0), offset=4.0, seed=2)
TWIG = [Surface(offset=5.0, seed=4), Surface(center=(0.1, 0.0, 3.5), radius=0.045, seed=3)]


@pytest.fixture(scope="module")
def slanted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slanted")
    K, poses, depths = write_scene(folder, [SLANTED])
    manifest = estimate_workspace(folder, StereoOptions(), backend="cpu", threads=1)
    return folder, K, poses, depths, manifest


def errors(folder, depths, i, kind="geometric"):
    """Relative depth errors of the pixels that have a depth, and their share, edges left out."""
    workspace = Workspace(folder)
    found = workspace.read_depth(workspace.views[i], kind)[8:-8, 8:-8]
    true = depths[i][8:-8, 8:-8]
    known = found > 0.0
    return np.abs(found - true)[known] / true[known], known.mean()


@pytest.mark.parametrize("sigma", [0.0, 5.0, 12.0])
@pytest.mark.parametrize("look", ["as it was", "warped by half a pixel", "before a burnt sky"])
def test_noise_is_told_from_slopes_and_edges(sigma, look):
    rng = np.random.default_rng(1)
    photo = np.tile(np.linspace(80.0, 160.0, 200)[None, :, None], (150, 1, 3))
    photo[:, 120:] -= 30.0
    photo[70:74] += 30.0
    photo += rng.normal(0.0, sigma, photo.shape)
    if look == "warped by half a pixel":
        photo, sigma = cv2.blur(photo, (2, 2)), sigma / 2
    if look == "before a burnt sky":
        photo[:90] = 255.0
    told = noise_variance(np.clip(np.rint(photo), 0, 255).astype(np.uint8))
    assert told == pytest.approx(max(sigma**2, 1.0), rel=0.12)


def test_the_cleaner_a_photo_the_less_colour_a_patch_bears_and_never_more_than_asked(slanted):
    folder, *_ = slanted
    problem = next(p for p in plan_views(Workspace(folder), 4) if p.view == 2)
    stereo = Stereo(Workspace(folder), StereoOptions())
    shape = stereo.pyramid(2)[0].shape
    rng, spread = np.random.default_rng(1), []
    for sigma in (0.0, 3.0, 30.0):
        noisy = np.clip(rng.normal(128.0, sigma, shape), 0, 255).astype(np.uint8)
        stereo.pyramid = lambda i, noisy=noisy: [noisy]
        spread.append(stereo.level(problem, 0).inv_color ** -0.5)
    assert spread[0] < 0.7 * spread[1] < 0.7 * spread[2]
    assert spread[2] == pytest.approx(StereoOptions.color_spread)


def test_slanted_plane_is_found_to_a_small_part_of_a_pixel(slanted):
    folder, _, _, depths, _ = slanted
    for i in (1, 2, 3):
        error, share = errors(folder, depths, i)
        assert share > 0.9
        assert np.median(error) < 0.001
        assert np.quantile(error, 0.95) < 0.005


def test_normals_are_the_planes_and_face_the_camera(slanted):
    folder, _, poses, _, _ = slanted
    workspace = Workspace(folder)
    normals = workspace.read_normals(workspace.views[2], "geometric")
    known = np.linalg.norm(normals, axis=2) > 0.0
    np.testing.assert_allclose(np.linalg.norm(normals[known], axis=1), 1.0, atol=1e-4)
    expected = -poses[2][0] @ np.array(SLANTED.normal) / np.linalg.norm(SLANTED.normal)
    cosine = np.median(normals[known] @ expected)
    assert cosine > np.cos(np.radians(8.0))


def test_either_fusion_takes_the_maps_and_lies_on_the_plane(slanted):
    folder, _, _, _, manifest = slanted
    normal = np.array(SLANTED.normal)
    for method in ("star", "colmap"):
        cloud = fuse_workspace(Workspace(folder), manifest["maps"], FusionOptions(), method=method)
        distance = np.abs(cloud.points @ normal - SLANTED.offset) / np.linalg.norm(normal)
        assert len(cloud) > 5000
        assert np.median(distance) < 0.005
        assert (cloud.normals @ -normal > 0.0).mean() > 0.95
        assert cloud["n_views"].min() >= 2
        assert cloud.frame == "colmap"


def test_thin_cylinder_before_a_wall_keeps_its_depth(tmp_path):
    _, _, depths = write_scene(tmp_path, TWIG)
    estimate_workspace(tmp_path, StereoOptions(), backend="cpu", threads=1)
    workspace = Workspace(tmp_path)
    found = workspace.read_depth(workspace.views[2], "geometric")
    twig = (depths[2] > 0.0) & (depths[2] < 4.0)
    wall = depths[2] > 4.0
    assert 2.0 < twig.sum(axis=1).mean() < 6.0  # the cylinder is about four pixels wide
    near = np.abs(found - depths[2]) < 0.03 * depths[2]
    assert near[twig].mean() > 0.7
    assert near[wall].mean() > 0.8


def test_equal_seed_gives_equal_bytes_and_whole_maps_are_kept(tmp_path, slanted):
    first, *_ = slanted
    write_scene(tmp_path, [SLANTED])
    estimate_workspace(tmp_path, StereoOptions(), backend="cpu", threads=2)
    mine, theirs = Workspace(tmp_path), Workspace(first)
    for view in mine.views:
        for kind in ("photometric", "geometric"):
            path = mine.depth_path(view, kind)
            assert path.read_bytes() == theirs.depth_path(view, kind).read_bytes()
    _assert_resumes(mine)


def test_a_process_that_compiles_gives_the_bytes_of_one_that_loads(tmp_path, slanted, project):
    """All but the first of a machine's runs find the kernels in the cache."""
    write_scene(tmp_path / "scene", [SLANTED])
    code = (
        "import sys; from cherrypicker.mvs.backends.choice import estimate_workspace as estimate;"
        "from cherrypicker.mvs.estimate import StereoOptions;"
        "estimate(sys.argv[1], StereoOptions(), backend='cpu')"
    )
    scripts = project / "scripts"
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(scripts)}
    call = [sys.executable, "-c", code, str(tmp_path / "scene")]
    subprocess.run(call, env=os.environ | cache, check=True)
    mine, theirs = Workspace(tmp_path / "scene"), Workspace(slanted[0])
    for view in mine.views:
        path = theirs.depth_path(view, "geometric")
        assert mine.depth_path(view, "geometric").read_bytes() == path.read_bytes()


def _assert_resumes(workspace):
    """A second run computes what is broken and nothing else; other settings compute all."""
    paths = [workspace.depth_path(view, "geometric") for view in workspace.views]
    content, times = paths[1].read_bytes(), [path.stat().st_mtime_ns for path in paths]
    paths[1].write_bytes(content[:-7])
    estimate_workspace(workspace.folder, StereoOptions(), backend="cpu")
    assert paths[1].read_bytes() == content
    again = [path.stat().st_mtime_ns for path in paths]
    assert [a == b for a, b in zip(again, times)] == [True, False, True, True, True]
    estimate_workspace(workspace.folder, StereoOptions(n_sources=3), backend="cpu")
    assert all(path.stat().st_mtime_ns > time for path, time in zip(paths, again))


def test_maps_that_another_program_made_are_kept_and_fused_with_ours(tmp_path):
    _, _, depths = write_scene(tmp_path, [SLANTED])
    workspace = Workspace(tmp_path)
    theirs = workspace.views[1]
    normal = np.zeros((*depths[1].shape, 3), np.float32)
    normal[..., 2] = -1.0
    for kind in ("photometric", "geometric"):
        workspace.depth_path(theirs, kind).parent.mkdir(parents=True, exist_ok=True)
        workspace.normal_path(theirs, kind).parent.mkdir(parents=True, exist_ok=True)
        workspace.write_maps(theirs, kind, depths[1].astype(np.float32), normal)
    content = workspace.depth_path(theirs, "geometric").read_bytes()
    manifest = estimate_workspace(tmp_path, StereoOptions(), backend="cpu")
    assert workspace.depth_path(theirs, "geometric").read_bytes() == content
    assert len(manifest["maps"]) == 5
    cloud = fuse_workspace(workspace, manifest["maps"], FusionOptions())
    assert (cloud["n_views"] == 5).mean() > 0.2


def test_fields_and_maps_are_two_views_of_the_same(slanted):
    folder, K, *_ = slanted
    workspace = Workspace(folder)
    view = workspace.views[2]
    depth = workspace.read_depth(view, "photometric")
    normals = workspace.read_normals(view, "photometric")
    again, normals_again = field_to_maps(maps_to_field(depth, normals, K), K)
    np.testing.assert_allclose(again, depth, rtol=1e-5)
    np.testing.assert_allclose(normals_again, normals, atol=1e-3)


def test_sources_and_depth_range_come_from_the_sparse_points(slanted):
    folder, _, _, depths, _ = slanted
    problems = plan_views(Workspace(folder), 3)
    assert len(problems) == 5
    for problem in problems:
        assert problem.view not in problem.sources
        assert len(problem.sources) == 3
        true = depths[problem.view]
        assert problem.depth_min < true.min()
        assert problem.depth_max > true.max()


def test_hills_behind_all_sparse_points_take_no_depth_of_the_tree(tmp_path):
    hills = Surface(offset=40.0, seed=4, texels_per_m=10.0)
    _, _, depths = write_scene(tmp_path, [hills, TWIG[1]], points_within=4.0)
    estimate_workspace(tmp_path, StereoOptions(), backend="cpu", threads=1)
    workspace = Workspace(tmp_path)
    found = workspace.read_depth(workspace.views[2], "geometric")
    twig = depths[2] < 4.0
    around = cv2.dilate(twig.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    assert (found[twig] > 0.0).mean() > 0.7
    assert ((found > 0.0) & (found < 10.0))[~around].mean() < 0.01  # 0.05 where none fits them
    matched = workspace.read_depth(workspace.views[2], "photometric")[~around]
    assert (np.abs(matched - 40.0) < 8.0).mean() > 0.5
    assert not (found > 30.0).any()  # a pixel of parallax is metres there


def test_a_photo_whose_sources_stand_where_it_does_gets_no_depth(slanted):
    workspace = Workspace(slanted[0])
    poses = workspace.poses.cam_from_world
    for pose in poses:
        pose[:, 3] = -pose[:, :3] @ [0.0, 0.0, 0.1]
    with pytest.raises(StageError, match="shares sparse points"):
        plan_views(workspace, 3)


def test_cuda_without_cuda_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(pycolmap, "has_cuda", True)
    assert first_choice("auto") == "cuda"
    monkeypatch.setattr(pycolmap, "has_cuda", False)
    assert (first_choice("auto"), first_choice("cuda")) == ("cpu", "cuda")
    with pytest.raises(StageError, match="pycolmap-cuda12"):
        estimate_workspace(tmp_path, StereoOptions(), backend="cuda")


def test_a_missing_photo_and_a_missing_model_are_told(tmp_path):
    write_scene(tmp_path, [SLANTED])
    (tmp_path / "images" / "view3.png").unlink()
    with pytest.raises(StageError, match="missing"):
        estimate_workspace(tmp_path, StereoOptions(), backend="cpu")
    with pytest.raises(StageError, match="sparse model"):
        Workspace(tmp_path / "nowhere")


def test_auto_falls_back_to_the_cpu_where_cuda_leaves_empty_maps(tmp_path, monkeypatch, caplog):
    write_scene(tmp_path, [SLANTED])

    def empty_maps(workspace, options, threads, shown):
        for view in workspace.views:
            size = (view.height, view.width)
            for kind in ("photometric", "geometric"):
                workspace.write_maps(view, kind, np.zeros(size), np.zeros((*size, 3)))
        return {view.name for view in workspace.views}

    monkeypatch.setattr(pycolmap, "has_cuda", True)
    monkeypatch.setitem(BACKENDS, "cuda", replace(BACKENDS["cuda"], run=empty_maps))
    with pytest.raises(StageError, match="no pixel has a consistent depth") as caught:
        estimate_workspace(tmp_path, StereoOptions(), backend="cuda")
    assert caught.value.key == "mvs.backend"
    manifest = estimate_workspace(tmp_path, StereoOptions(), backend="auto")
    assert manifest["backend"] == "cpu"
    assert min(manifest["share_with_depth"].values()) > 0.5
    assert "CUDA stereo left all 5 depth maps empty" in caplog.text


def test_a_new_backend_is_one_row_of_the_table(tmp_path, monkeypatch):
    _, _, depths = write_scene(tmp_path, [SLANTED])

    def true_maps(workspace, options, threads, shown):
        assert (options.n_sources, threads, shown) == (3, 2, None)
        for view, depth in zip(workspace.views, depths):
            normals = np.zeros((*depth.shape, 3), np.float32)
            workspace.write_maps(view, "geometric", depth.astype(np.float32), normals)
        return {view.name for view in workspace.views}

    fake = Backend("Oracle", true_maps, "7 + 0 dense_mp", "1", 3)
    monkeypatch.setitem(BACKENDS, "oracle", fake)
    manifest = estimate_workspace(tmp_path, StereoOptions(n_sources=3), backend="oracle", threads=2)
    assert manifest["backend"] == "oracle"
    assert min(manifest["share_with_depth"].values()) == pytest.approx(1.0)
    scan = ScanSize(stereo=first_choice("oracle"), dense_mp=100.0)
    assert scan.cpu_s("estimate_depth") == 7.0
    assert scan.cost("estimate_depth").max_threads == 3


def test_the_config_allows_every_backend(project):
    schema = yaml.safe_load((project / "workflow/schemas/config.schema.yaml").read_text())
    allowed = schema["properties"]["mvs"]["properties"]["backend"]["enum"]
    assert set(allowed) == {"auto", *BACKENDS}
