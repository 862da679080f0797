"""The scorer of dense clouds, on cylinders whose answers are known."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.poses import Poses
from cherrypicker.skeleton import Skeleton
from cherrypicker_lab.dense.surface import (
    judge_points,
    refine_similarity,
    score_cloud,
)
from cherrypicker_lab.dense.truth import count_views, load_true_surface, sample_skeleton
from cherrypicker_lab.orchard.scene.cameras import CameraModel, Ring, ring_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.truth import write_truth


def stem_with_branches():
    """A stem of radius 40 mm, 1 m tall, with branches of 12, 7 and 3 mm to three sides."""
    points = [[0, 0, z] for z in np.linspace(0, 1, 21)]
    parent, radius, order = [-1, *range(20)], [0.04] * 21, [0] * 21
    for i, (thick, height) in enumerate(((0.012, 8), (0.007, 12), (0.003, 16))):
        direction = np.array([np.cos(2.1 * i), np.sin(2.1 * i), 0.4 + 0.2 * i])
        for k in range(1, 11):
            parent.append(height if k == 1 else len(points) - 1)
            points.append(np.array(points[height]) + 0.05 * k * direction)
            radius.append(thick)
            order.append(1)
    label = np.where(np.array(order) == 0, Label.TRUNK, Label.BRANCH)
    return Skeleton(
        np.array(points, float), np.array(parent), np.array(radius), label,
        {"order": np.array(order)},
    )  # fmt: skip


@pytest.fixture(scope="module")
def surface():
    made = sample_skeleton(stem_with_branches(), step=0.002)
    made.n_views[:] = 5
    return made


def test_samples_lie_on_the_tubes_and_cover_their_area(surface):
    stem = surface.is_trunk
    distance = np.hypot(*surface.points[stem, :2].T)
    np.testing.assert_allclose(distance, 0.04, atol=1e-9)
    # what the branches' feet cover is missing from the stem, nothing else
    assert surface.area[stem].sum() == pytest.approx(2 * np.pi * 0.04, rel=0.02)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0)
    inside = np.hypot(*surface.points[~stem, :2].T) < 0.038
    assert not (inside & (surface.points[~stem, 2] < 0.98)).any()


def test_sampled_surface_is_that_of_the_rendered_mesh():
    scene = generate_scene(3, habit="vase", height=1.0, density=0.5, neighbours=0, markers=[])
    skeleton = scene.target.skeleton()
    made = sample_skeleton(skeleton)
    (thing,) = scene.tree_objects(row_step=0.002, side_step=0.002, max_sides=160)
    mesh = cKDTree(thing.mesh.vertices)
    assert np.quantile(mesh.query(made.points)[0], 0.999) < 0.002


def test_shifted_surface_fails_at_5_mm_and_passes_at_10_mm(surface):
    off = surface.points + 0.007 * surface.normals
    report = score_cloud(off, surface)
    assert report["all"]["5mm"]["accuracy"] < 0.05
    assert report["all"]["5mm"]["f1"] < 0.05
    assert report["all"]["10mm"]["accuracy"] > 0.999
    assert report["all"]["10mm"]["completeness"] > 0.99
    assert report["median_error_m"] == pytest.approx(0.007, abs=0.0003)


def test_classes_are_those_of_the_nearest_wood(surface):
    thin_wood = surface.radius < 0.005
    report = score_cloud(surface.points[~thin_wood], surface)
    assert report["branch_below_5mm"]["10mm"]["completeness"] < 0.1
    for name in ("trunk", "branch_10_30mm", "branch_5_10mm"):
        assert report[name]["5mm"]["completeness"] == pytest.approx(1.0, abs=1e-3), name
        assert report[name]["5mm"]["accuracy"] == 1.0, name
    assert report["branch_30mm"]["5mm"]["f1"] is None


def test_floaters_beside_branches_count_and_other_surfaces_do_not(surface):
    n = len(surface.points) // 10
    rng = np.random.default_rng(0)
    floaters = np.column_stack([rng.uniform(-0.4, 0.4, (n, 2)), rng.uniform(0.3, 1.0, n)])
    floaters = floaters[cKDTree(surface.points).query(floaters)[0] > 0.02]
    floaters = floaters[judge_points(floaters, surface)]
    assert len(floaters) > n // 2
    cloud = np.concatenate([surface.points, floaters])
    above = (surface.points[:, 2] >= surface.points[:, 2].min() + 0.12).sum()
    expected = above / (above + len(floaters))
    assert score_cloud(cloud, surface)["all"]["20mm"]["accuracy"] == pytest.approx(expected)
    with_board = surface.select(np.arange(len(surface.points)))
    with_board.others = floaters + 0.005
    assert score_cloud(cloud, with_board)["all"]["20mm"]["accuracy"] == 1.0


def test_far_points_and_the_lowest_12_cm_are_not_judged(surface):
    points = np.array([[0.04, 0, 0.05], [0.04, 0, 0.5], [5.0, 0, 0.5], [0, 0, 0.5]])
    assert judge_points(points, surface).tolist() == [False, True, False, True]
    with pytest.raises(StageError, match="near the true tree"):
        score_cloud(points[2:3], surface)


def test_unseen_surface_does_not_count(surface):
    back = surface.points[:, 0] < 0
    half = surface.select(np.arange(len(surface.points)))
    half.n_views = np.where(back, 2, 3)
    report = score_cloud(surface.points[~back], half)
    assert report["all"]["5mm"]["completeness"] == pytest.approx(1.0, abs=1e-3)
    assert report["visible_share"] < 0.8


def test_similarity_is_recovered(surface):
    rng = np.random.default_rng(1)
    turn = Rotation.from_rotvec(np.radians([0.6, -0.4, 0.5])).as_matrix()
    cloud = surface.points + rng.normal(0, 0.001, surface.points.shape)
    outliers = rng.uniform(-0.4, 0.4, (2000, 3)) + [0, 0, 0.6]
    moved = 1.01 * np.concatenate([cloud, outliers]) @ turn.T + [0.006, -0.008, 0.005]
    scale, rotation, translation = refine_similarity(moved, surface)
    assert scale == pytest.approx(1 / 1.01, abs=1e-3)
    np.testing.assert_allclose(rotation @ turn, np.eye(3), atol=2e-3)
    placed = scale * moved[: len(cloud)] @ rotation.T + translation
    assert np.linalg.norm(placed - cloud, axis=1).max() < 0.0015


def test_views_are_counted_where_a_camera_sees_the_bark(surface):
    K = np.array([[400.0, 0, 200], [0, 400, 300], [0, 0, 1]])
    looks_along_x = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    pose = np.c_[looks_along_x, -looks_along_x @ np.array([-1.5, 0, 0.5])]
    poses = Poses(["a"], [pose], [K], [400], [600])
    n_views = count_views(surface, poses, step=0.002)
    stem = surface.is_trunk & (np.abs(surface.points[:, 1]) < 0.02)
    front = surface.normals[:, 0] < -0.5
    assert n_views[stem & front].mean() > 0.97
    assert n_views[stem & (surface.normals[:, 0] > 0.1)].sum() == 0
    # the far side of a twig is too near to its front to be hidden by it
    twig = surface.radius < 0.005
    assert n_views[twig & (surface.normals[:, 0] < -0.5)].mean() > 0.9
    assert n_views[twig & (surface.normals[:, 0] > 0.2)].sum() == 0
    # the branch that grows away from the camera is hidden where the stem stands before it
    hidden = ~surface.is_trunk & (surface.points[:, 0] > 0.05)
    hidden &= np.abs(surface.points[:, 1]) < 0.03
    assert hidden.sum() > 100
    assert n_views[hidden].sum() == 0


def test_the_truth_of_a_scene_is_loaded(tmp_path):
    scene = generate_scene(3, habit="vase", height=1.0, density=0.3, neighbours=0, markers=[])
    poses = ring_poses([Ring(6, 0.6, 2.2, 0.5)], CameraModel(300, 300, 250.0), seed=0)
    write_truth(tmp_path, scene, poses, n_points=20_000)
    every = load_true_surface(tmp_path, step=0.003)
    assert every.n_views.max() > 2
    assert len(every.others) > 1000
