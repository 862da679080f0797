"""The default contraction: its Laplacian, its thickness weights, the tube of the stem."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import skeleton_shapes
from scipy.spatial import cKDTree
from skeleton_shapes import labelled_cloud, sample_axes, small_tree, tube

from cherrypicker.contraction.contract_points import contract_points, preset_options
from cherrypicker.contraction.contract_wood import contract_wood
from cherrypicker.contraction.laplacian_stars import star_laplacian
from cherrypicker.contraction.tube import recentre_stem
from cherrypicker.geometry.local_frames import neighborhood_axes, neighborhood_spread
from cherrypicker.wood.feet import find_stems
from cherrypicker_lab.skeletons.distances import chamfer_cm2


def neighbors_of(points, k):
    return cKDTree(points).query(points, k + 1)[1][:, 1:]


def grid(n=20, step=0.01, seed=0):
    """A jittered grid in the plane z = 1, and which of its points lie inside."""
    x, y = np.meshgrid(np.arange(n), np.arange(n))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1).astype(float)
    points[:, :2] += np.random.default_rng(seed).uniform(-0.3, 0.3, (n * n, 2))
    inside = (points[:, :2] > 3).all(axis=1) & (points[:, :2] < n - 4).all(axis=1)
    return step * points + [0, 0, 1], inside


def test_stars_give_the_cotangent_laplacian_of_a_plane():
    points, inside = grid()
    L, mass = star_laplacian(points, neighbors_of(points, 14))
    np.testing.assert_allclose(L.sum(axis=1), 0, atol=1e-9)
    np.testing.assert_allclose((L @ points)[inside], 0, atol=1e-9)  # linear functions are harmonic
    # weak form: -L x^2 = 2 * (Voronoi area), on average the area of a cell
    np.testing.assert_allclose(-(L @ points[:, 0] ** 2)[inside].mean() / 2, 1e-4, rtol=0.03)
    np.testing.assert_allclose(mass[inside].mean(), 1e-4, rtol=0.03)
    assert abs(L - L.T).max() < 1e-12 and L.diagonal().min() > 0


def test_stars_do_not_depend_on_the_order_of_the_neighbors():
    points, _ = grid(seed=2)
    neighbors = neighbors_of(points, 12)
    L, mass = star_laplacian(points, neighbors)
    turned, mass_turned = star_laplacian(points, neighbors[:, ::-1])
    assert abs(L - turned).max() < 1e-9 * abs(L).max()
    np.testing.assert_allclose(mass, mass_turned)


def test_stars_bear_points_that_coincide():
    points = np.repeat(grid(8)[0], 3, axis=0)
    L, mass = star_laplacian(points, neighbors_of(points, 12))
    assert np.isfinite(L.data).all() and np.isfinite(mass).all()


def test_spread_across_a_cylinder_is_its_radius_squared():
    points = tube((0, 0, 0), (0, 0, 0.4), 0.01, 60_000, rng=np.random.default_rng(0))
    near = neighbors_of(points, 250)
    full = np.full(len(points), 250)
    inner = (points[:, 2] > 0.05) & (points[:, 2] < 0.35)
    spread, flatness = neighborhood_spread(points, near, full)
    assert np.sqrt(np.median(spread[inner])) == pytest.approx(0.01, rel=0.1)
    assert np.median(flatness[inner]) < 0.1
    _, flatness = neighborhood_spread(points, near, np.full(len(points), 12))
    assert np.median(flatness[inner]) > 0.2
    line = np.arange(50.0)[:, None] * [0, 0.6, 0.8]
    axes, linearity = neighborhood_axes(line, neighbors_of(line, 6))
    np.testing.assert_allclose(np.abs(axes @ [0, 0.6, 0.8]), 1, atol=1e-9)
    np.testing.assert_allclose(linearity, 1, atol=1e-9)


def test_a_twig_keeps_its_tip_where_a_thick_stem_contracts():
    rng = np.random.default_rng(3)
    stem = tube((0, 0, 0), (0, 0, 0.6), 0.03, 8_000, rng=rng)  # no class says that it is thick
    twig = tube((0.03, 0, 0.3), (0.33, 0, 0.3), 0.004, 30_000, rng=rng, noise=0.001)
    points = np.vstack([stem, twig])
    contracted = contract_points(points, options=preset_options("default")).points
    of_twig = contracted[len(stem) :]
    assert of_twig[:, 0].max() > 0.32  # of 0.33
    free = of_twig[of_twig[:, 0] > 0.08]
    assert np.median(np.linalg.norm(free[:, 1:] - [0, 0.3], axis=1)) < 0.002
    of_stem = contracted[: len(stem)]
    high = of_stem[(of_stem[:, 2] > 0.4) & (of_stem[:, 2] < 0.5)]
    assert np.median(np.linalg.norm(high[:, :2], axis=1)) < 0.02


def test_a_dense_cloud_contracts_at_its_sites_to_the_same_axis():
    points = tube((0, 0, 0), (0.3, 0, 0.4), 0.008, 400_000, rng=np.random.default_rng(4))
    dense = contract_points(points, options=preset_options("default")).points
    assert dense.shape == points.shape
    along = np.array([0.6, 0, 0.8])
    away = np.linalg.norm(dense - (dense @ along)[:, None] * along, axis=1)
    assert np.quantile(away, 0.9) < 0.003
    # points keep their places along the branch rather than fall onto the sites
    shift = np.abs((dense - points) @ along)
    assert np.median(shift) < 0.001 and len(np.unique(dense.round(4), axis=0)) > len(points) / 2


def test_equal_input_gives_equal_bytes_and_any_frame_the_same_points():
    points, labels, _ = small_tree(noise=0.002)
    weights = np.where(labels == 1, 10.0, 1.0)
    first, second = (contract_points(points, weights, preset_options()).points for _ in range(2))
    assert first.tobytes() == second.tobytes()
    shift = np.array([365_000.0, 5_620_000.0, 310.0])
    there = contract_points(points + shift, weights, preset_options()).points - shift
    assert np.median(np.linalg.norm(first - there, axis=1)) < 1e-4


def test_a_hole_in_the_stem_does_not_bend_its_axis():
    rng = np.random.default_rng(5)
    stem = tube((0, 0, 0), (0.1, 0, 1.2), 0.06, 9_000, rng=rng, end_radius=0.03, noise=0.002)
    for height, angle in ((0.4, 0.0), (0.8, 2.0)):
        centre = [height / 12 + 0.05 * np.cos(angle), 0.05 * np.sin(angle), height]
        stem = stem[np.linalg.norm(stem - centre, axis=1) > 0.08]
    plain = contract_points(stem, np.full(len(stem), 10.0), preset_options()).points
    moved, is_moved = recentre_stem(stem, plain, np.zeros(3), spacing=0.01)
    away = np.hypot(moved[:, 0] - moved[:, 2] / 12, moved[:, 1])
    before = np.hypot(plain[:, 0] - plain[:, 2] / 12, plain[:, 1])
    assert is_moved.mean() > 0.95
    assert np.quantile(away[is_moved], 0.95) < 0.004 < np.quantile(before, 0.95)


def test_two_stems_are_not_taken_for_one_tube():
    rng = np.random.default_rng(6)
    parts = [tube((x, 0, 0), (x, 0, 1), 0.03, 12_000, rng=rng) for x in (-0.07, 0.07)]
    points = np.vstack(parts)
    plain = contract_points(points, np.full(len(points), 10.0), preset_options()).points
    moved, _ = recentre_stem(points, plain, np.zeros(3), spacing=0.01)
    inner = (points[:, 2] > 0.1) & (points[:, 2] < 0.9)
    assert np.quantile(np.abs(np.abs(moved[inner, 0]) - 0.07), 0.95) < 0.03


def test_wrong_labels_do_not_carry_branches_onto_the_stem():
    points, labels, axes = small_tree(noise=0.002)
    rng = np.random.default_rng(8)
    flipped = rng.random(len(labels)) < 0.1
    scattered = np.where(flipped, 3 - labels, labels)
    whole_branch = np.where((points[:, 0] > 0.02) & (points[:, 2] < 0.76), 1, labels)
    truth = sample_axes(axes)
    for wrong in (scattered, whole_branch):
        contracted, report = contract_wood(
            labelled_cloud(points, wrong), options=preset_options(), voxel_size_m=0.01
        )
        away = cKDTree(truth).query(contracted.points)[0]
        assert np.quantile(away, 0.99) < 0.02
        assert contracted.points[:, 0].max() > 0.43  # the branch keeps its tip
        assert report["n_on_stem_axis"] > 500


def test_equal_bytes_for_any_number_of_threads():
    script = (
        "import hashlib, numpy as np\n"
        "from skeleton_shapes import labelled_cloud, small_tree\n"
        "from cherrypicker.contraction.contract_wood import contract_wood\n"
        "from cherrypicker.contraction.contract_points import preset_options\n"
        "cloud = labelled_cloud(*small_tree(noise=0.002)[:2])\n"
        "points = contract_wood(cloud, options=preset_options(), voxel_size_m=0.012)[0].points\n"
        "print(hashlib.sha256(points.tobytes()).hexdigest())\n"
    )
    folders = f"{Path(skeleton_shapes.__file__).parent}:{Path(__file__).parents[2] / 'scripts'}"
    found = set()
    for threads in ("1", "4"):
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
        environment = os.environ | dict.fromkeys(names, threads) | {"PYTHONPATH": folders}
        done = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, check=True
        )
        found.add(done.stdout)
    assert len(found) == 1


def test_a_branch_that_hangs_to_the_ground_is_no_stem():
    rng = np.random.default_rng(7)
    stem = tube((0, 0, 0), (0, 0, 1.5), 0.04, 20_000, rng=rng)
    branch = np.vstack([tube((0, 0, 0.7), (0.6, 0, 0.5), 0.01, 40_000, rng=rng),
                        tube((0.6, 0, 0.5), (0.65, 0, 0.0), 0.008, 40_000, rng=rng)])  # fmt: skip
    points = np.vstack([stem, branch])
    labels = np.repeat([1, 2], [len(stem), len(branch)])
    assert len(find_stems(points)) == 2
    assert len(find_stems(points, labels=labels)) == 1
    assert len(find_stems(points, labels=np.full(len(points), 2))) == 2
    contracted, report = contract_wood(labelled_cloud(points, labels), options=preset_options())
    assert report["wood"]["n_neighbors_cut"] == 0
    assert contracted.points[:, 0].max() > 0.6


def test_default_beats_plain_and_published_contraction_on_a_small_tree():
    points, labels, axes = small_tree(noise=0.002)
    cloud, truth = labelled_cloud(points, labels), sample_axes(axes)
    found = {}
    for name, method, preset in (
        ("default", "slbc", "default"),
        ("plain", "lbc", "default"),
        ("published", "slbc", "paper"),
    ):
        options = preset_options(preset)
        contracted, _ = contract_wood(cloud, method=method, options=options, voxel_size_m=0.01)
        found[name] = chamfer_cm2(contracted.points, truth)
    assert found["default"] < 0.5 * found["published"]
    assert found["default"] <= found["plain"] < found["published"]
    assert found["default"] < 0.3
