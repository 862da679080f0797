"""Outlier and sky-silhouette filters."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import denoise_cloud as stage
from cherrypicker.denoising.denoise import (
    DenoiseOptions,
    denoise_cloud,
    neighbor_means,
    statistical_filter,
    statistical_inliers,
)
from cherrypicker.errors import StageError
from cherrypicker.pointcloud import PointCloud, read_cloud, write_cloud
from cherrypicker.sky.colors import SkyColors, write_sky_colors

WHITE = np.array([0.9, 0.93, 0.97])
BARK = np.array([0.35, 0.28, 0.22])
SKY = SkyColors(WHITE[None].astype(np.float32), np.zeros(1, np.int32), np.ones(1), 100)


def inliers(points, n_neighbors, std_ratio):
    mean_distance, _ = neighbor_means(points, np.zeros(len(points)), n_neighbors)
    return statistical_inliers(mean_distance, std_ratio)


def pole_with_fringe():
    """A pole of 2 cm radius, white below 0.6 m, and a sky-coloured sheath 6 cm off above 1.2 m."""
    rng = np.random.default_rng(0)

    def tube(radius, low, high, n):
        a, z = rng.uniform(0, 2 * np.pi, n), rng.uniform(low, high, n)
        return np.column_stack([radius * np.cos(a), radius * np.sin(a), z])

    pole, fringe = tube(0.02, 0.2, 1.7, 6000), tube(0.08, 1.2, 1.7, 300)
    colors = np.tile(BARK, (6000, 1))
    colors[pole[:, 2] < 0.6] = WHITE
    points = np.vstack([pole, fringe])
    colors = np.vstack([colors, np.tile(WHITE, (300, 1))])
    return PointCloud(points, colors), np.arange(len(points)) >= 6000


def speak(asked, sure):
    """Photos that show sky through all that is 5 cm from the pole, and know nothing above it."""
    assert len(sure)
    off = np.hypot(asked[:, 0], asked[:, 1]) > 0.05
    return np.where(asked[:, 2] > 10, 0.0, np.where(off, -4.0, -2.0))


@pytest.mark.parametrize(("k", "ratio"), [(20, 2.0), (8, 0.5), (30, 1.0)])
def test_statistical_filter_is_open3d_s(k, ratio):
    o3d = pytest.importorskip("open3d")
    rng = np.random.default_rng(1)
    points = np.vstack([rng.normal(0, 0.1, (3000, 3)), rng.uniform(-3, 3, (100, 3))])
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    _, kept = cloud.remove_statistical_outlier(nb_neighbors=k, std_ratio=ratio)
    found = np.flatnonzero(inliers(points, k, ratio))
    assert np.array_equal(found, np.sort(np.asarray(kept)))
    np.testing.assert_array_equal(statistical_filter(points, k, ratio), inliers(points, k, ratio))


def test_the_filter_alone_is_open3d_s_and_beside_the_photos_ours(monkeypatch):
    rng = np.random.default_rng(1)
    points = np.vstack([rng.normal(0, 0.1, (3000, 3)), rng.uniform(-3, 3, (100, 3))])
    cloud = PointCloud(points, fields={"n_views": np.full(len(points), 9, np.uint8)})
    options = DenoiseOptions(sky_color_distance=0.0, ask_photos=False)
    ours, _, _ = denoise_cloud(cloud, SKY, None, options)
    called = []
    monkeypatch.setattr(
        "cherrypicker.denoising.denoise.statistical_filter",
        lambda *given: called.append(1) or statistical_filter(*given),
    )
    alone, _, _ = denoise_cloud(cloud, SKY, None, replace(options, min_view_ratio=0))
    np.testing.assert_array_equal(ours.points, alone.points)
    assert called and len(ours) < len(points)


def test_isolated_points_go():
    rng = np.random.default_rng(2)
    line = np.column_stack([np.linspace(0, 1, 2000), *rng.normal(0, 0.002, (2, 2000))])
    far = rng.uniform(2, 4, (20, 3))
    keep = inliers(np.vstack([line, far]), 20, 3.0)
    assert keep[:2000].mean() > 0.99 and not keep[2000:].any()


def test_tiny_clouds_stay_whole():
    assert inliers(np.zeros((1, 3)), 20, 2.0).all()
    assert inliers(np.zeros((5, 3)), 20, 2.0).all()


def test_fringe_goes_and_white_paint_stays():
    cloud, is_fringe = pole_with_fringe()
    options = DenoiseOptions(std_ratio=1e9)
    kept, report, _ = denoise_cloud(cloud, SKY, speak, options)
    np.testing.assert_array_equal(kept.points, cloud.points[~is_fringe])
    assert report["n_input"] == len(cloud)
    assert report["n_removed_sky"] == len(cloud) - len(kept)
    assert report["n_kept_by_photos"] + report["n_removed_sky"] == report["n_sky_colored"]


def test_points_of_which_no_photo_knows_stay():
    cloud = PointCloud(np.array([[0, 0, 50.0], [0, 0, 51], [0, 0, 53]]), np.tile(WHITE, (3, 1)))
    options = DenoiseOptions(std_ratio=1e9)
    kept, _, _ = denoise_cloud(cloud, SKY, speak, options)
    assert len(kept) == 3


def test_without_sky_or_colors_nothing_is_asked():
    def never(asked, sure):
        raise AssertionError("asked")

    cloud, _ = pole_with_fringe()
    none = SkyColors(np.zeros((0, 3), np.float32), np.zeros(0, np.int32), np.zeros(0), 0)
    options = DenoiseOptions(std_ratio=1e9)
    assert len(denoise_cloud(cloud, none, never, options)[0]) == len(cloud)
    bare = PointCloud(cloud.points)
    assert len(denoise_cloud(bare, SKY, never, options)[0]) == len(cloud)


def test_nothing_left_is_an_error_that_names_the_key():
    cloud = PointCloud(np.random.default_rng(0).random((50, 3)), np.tile(WHITE, (50, 1)))

    def all_sky(asked, sure):
        return np.full(len(asked), -4.0)

    with pytest.raises(StageError, match=r"denoise\.sky_color_distance"):
        denoise_cloud(cloud, SKY, all_sky, DenoiseOptions(std_ratio=1e9))
    with pytest.raises(StageError, match=r"denoise\.std_ratio"):
        seen = cloud.with_fields(n_views=np.full(50, 3, np.uint8))
        denoise_cloud(seen, SKY, all_sky, DenoiseOptions(std_ratio=-100.0))


def test_what_two_photos_agree_on_goes_where_ten_see_the_rest():
    rng = np.random.default_rng(0)
    wood = rng.uniform(0, [0.1, 0.1, 2.0], (2000, 3))
    floaters = rng.uniform([0.5, 0.5, 1.0], [1.0, 1.0, 1.1], (100, 3))
    twig = np.column_stack([np.linspace(0.1, 0.4, 60), np.zeros(60), np.full(60, 1.5)])
    n_views = np.concatenate([rng.integers(6, 15, 2000), np.full(100, 2), rng.integers(3, 8, 60)])
    cloud = PointCloud(
        np.vstack([wood, floaters, twig]), fields={"n_views": n_views.astype(np.uint8)}
    )
    options = DenoiseOptions(std_ratio=1e9, sky_color_distance=0.0, ask_photos=False)
    kept, report, _ = denoise_cloud(cloud, SKY, None, options)
    assert report["n_removed_views"] == 100
    np.testing.assert_array_equal(kept.points, np.vstack([wood, twig]))
    few = cloud.with_fields(n_views=np.full(len(cloud), 2, np.uint8))
    assert len(denoise_cloud(few, SKY, None, options)[0]) == len(cloud)


def test_isolated_points_stay_where_the_photos_show_a_twig():
    rng = np.random.default_rng(2)
    line = np.column_stack([np.linspace(0, 1, 2000), *rng.normal(0, 0.002, (2, 2000))])
    tip = np.column_stack([np.linspace(1.5, 2.5, 8), np.zeros((8, 2))])
    floaters = rng.uniform(3, 4, (20, 3))
    few = tip + (0, 0.5, 0)
    points = np.vstack([line, tip, floaters, few])
    is_tip = np.isin(np.arange(len(points)), np.arange(2000, 2008))
    is_few = np.arange(len(points)) >= 2028
    cloud = PointCloud(points).with_fields(kind=is_tip + 2 * is_few)

    def look(asked, sure):
        assert len(asked) < 100 and len(sure) == 2000
        kind = cloud["kind"][cKDTree(points).query(asked)[1]]
        return np.choose(kind, [-2.0, 1.0, 0.0])

    kept, report, _ = denoise_cloud(cloud, SKY, look, DenoiseOptions())
    assert np.count_nonzero(kept["kind"] == 1) == 8 == report["n_kept_twigs"]
    assert report["n_removed_statistical"] == 28 and (kept["kind"] != 2).all()
    off = DenoiseOptions(ask_photos=False)
    assert len(denoise_cloud(cloud, SKY, None, off)[0]) == 2000


def test_the_papers_filter_goes_by_colour_alone():
    cloud, is_fringe = pole_with_fringe()
    options = DenoiseOptions(std_ratio=1e9, ask_photos=False)
    kept, report, _ = denoise_cloud(cloud, SKY, None, options)
    is_white = np.linalg.norm(cloud.colors - WHITE, axis=1) < 0.1
    assert len(kept) == np.count_nonzero(~is_white) and report["n_kept_by_photos"] == 0


def test_what_all_see_of_the_ground_says_nothing_about_twigs():
    rng = np.random.default_rng(0)
    ground = rng.uniform([-1, -1, 0], [1, 1, 0.01], (4000, 3))
    wood = rng.uniform([0, 0, 0.5], [0.1, 0.1, 2.0], (1000, 3))
    twig = np.column_stack([np.linspace(0.3, 0.6, 60), np.zeros(60), np.full(60, 1.5)])
    n_views = np.concatenate([np.full(4000, 30), np.full(1000, 10), np.full(60, 4)])
    points = np.vstack([ground, wood, twig])
    cloud = PointCloud(points, fields={"n_views": n_views.astype(np.uint8)})
    options = DenoiseOptions(std_ratio=1e9, sky_color_distance=0.0, ask_photos=False)
    assert len(denoise_cloud(cloud, SKY, None, options, ground_height=0.2)[0]) == len(cloud)
    assert len(denoise_cloud(cloud, SKY, None, options)[0]) == len(cloud) - 60
    sure = cloud.with_fields(n_views=np.where(n_views == 4, 5, n_views).astype(np.uint8))
    assert len(denoise_cloud(sure, SKY, None, options)[0]) == len(cloud)


def test_the_stage_writes_what_the_filters_leave(tmp_path, monkeypatch):
    monkeypatch.setattr(stage, "read_poses", lambda _: SimpleNamespace(centers=np.ones((2, 3))))
    monkeypatch.setattr(stage, "ScanPhotos", lambda *given: None)
    monkeypatch.setattr(stage, "ask_points", lambda photos, asked, sure, seed: speak(asked, sure))
    cloud, is_fringe = pole_with_fringe()
    write_cloud(tmp_path / "cropped.ply", cloud)
    write_sky_colors(tmp_path / "sky.npz", SKY)
    files = [str(tmp_path / name) for name in ("cropped.ply", "p", "c", "e", "sky.npz")]
    written = [str(tmp_path / name) for name in ("out.ply", "out.json", "out.npz")]
    stage.main(*files, *written, options=DenoiseOptions())
    kept, removed_by = read_cloud(written[0]), np.load(written[2])["removed_by"]
    np.testing.assert_allclose(kept.points, cloud.points[removed_by == 0], atol=1e-5)
    assert removed_by[is_fringe].all() and len(kept) < len(cloud) - 250
