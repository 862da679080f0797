"""The library's surface: arrays and Open3D clouds in, skeletons out; the examples in it run."""

import doctest
import importlib

import numpy as np
import pytest
from skeleton_shapes import labelled_cloud, small_tree

from cherrypicker.api import contract, skeletonize
from cherrypicker.contraction.contract_points import SkeletonOptions
from cherrypicker.contraction.contract_wood import contract_wood
from cherrypicker.wood.thinned import GrowthOptions

MODULES = (
    "cherrypicker.api",
    "cherrypicker_lab.skeletons.distances",
)


@pytest.fixture(scope="module")
def tree():
    points, labels, axes = small_tree(noise=0.001)
    return points[::3], labels[::3], axes


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_the_documentation_run(name):
    failed, attempted = doctest.testmod(importlib.import_module(name))
    assert attempted > 0 and failed == 0


def test_every_kind_of_cloud_gives_the_same_points(tree):
    points, labels, _ = tree
    from_array, source = contract(points, labels)
    from_cloud, _ = contract(labelled_cloud(points, labels))
    np.testing.assert_array_equal(from_array, from_cloud)
    np.testing.assert_array_equal(source, np.arange(len(points)))


def test_open3d_clouds_are_taken(tree):
    open3d = pytest.importorskip("open3d")
    points, labels, _ = tree
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    np.testing.assert_array_equal(contract(cloud, labels)[0], contract(points, labels)[0])


def test_any_classes_and_weights(tree):
    points, labels, _ = tree
    renamed = np.where(labels == 1, 40, 7)
    same, _ = contract(points, renamed, weights={40: 10.0}, stem=40)
    np.testing.assert_array_equal(same, contract(points, labels)[0])
    plain, _ = contract(points, labels, method="lbc", max_iterations=1)
    semantic, _ = contract(points, labels, method="slbc", max_iterations=1)
    assert np.abs(plain - semantic).max() > 1e-3
    np.testing.assert_array_equal(plain, contract(points, method="lbc", max_iterations=1)[0])


def test_the_parameters_of_the_last_release_say_what_replaces_them(tree):
    points, labels, _ = tree
    with pytest.warns(DeprecationWarning, match="preset='paper' is now method='slbc'"):
        old, _ = contract(points, labels, preset="paper", max_iterations=1)
    np.testing.assert_array_equal(old, contract(points, labels, method="slbc", max_iterations=1)[0])
    with pytest.warns(DeprecationWarning, match="graph='mst' is now method='lbc'"):
        skeletonize(points, labels, method="lbc", preset="paper", graph="mst", voxel_size_m=0.02)


def test_the_paper_is_the_same_from_the_library_and_in_the_workflow(tree):
    points, labels, _ = tree
    options = SkeletonOptions("slbc", max_iterations=2)
    cloud = labelled_cloud(points, labels)
    staged, _ = contract_wood(cloud, GrowthOptions(voxel_size_m=0.01), options=options)
    alone, source = contract(points, labels, method="slbc", voxel_size=0.01, max_iterations=2)
    np.testing.assert_array_equal(staged.points, alone)
    np.testing.assert_array_equal(staged["source"], source)


def test_a_lone_label_is_outvoted(tree):
    points, labels, _ = tree
    lone = labels.copy()
    lone[np.argmax(points[:, 0])] = 1  # at a tip, far from the stem
    np.testing.assert_array_equal(contract(points, lone)[0], contract(points, labels)[0])


def test_thinned_points_name_their_source(tree):
    points, labels, _ = tree
    thin, source = contract(points, labels, voxel_size=0.02)
    assert len(thin) == len(source) < len(points)
    assert np.linalg.norm(thin - points[source], axis=1).max() < 0.08


def test_a_callback_that_raises_stops(tree):
    points, labels, _ = tree

    class Stop(Exception):
        pass

    def stop(iteration, ratio, current):
        assert iteration == 1 and 0 < ratio < 1 and current.shape == points.shape
        raise Stop

    with pytest.raises(Stop):
        contract(points, labels, method="slbc", callback=stop)
    with pytest.raises(ValueError, match="limbs do not iterate"):
        contract(points, labels, callback=stop)


def test_what_does_not_fit_is_refused(tree):
    points, labels, _ = tree
    with pytest.raises(ValueError, match="labels must have shape"):
        contract(points, labels[:-1])
    with pytest.raises(ValueError, match="points must have shape"):
        contract(points[:, :2])
    with pytest.raises(ValueError, match="need labels"):
        contract(points, weights={1: 10.0})
    with pytest.raises(ValueError, match="positive"):
        contract(points, labels, weights={1: 0.0})
    with pytest.raises(TypeError, match="n_neighbours"):
        contract(points, labels, n_neighbours=12)


@pytest.mark.parametrize("method", ["limbs", "slbc", "lbc"])
def test_a_skeleton_in_one_call(tree, method):
    points, labels, _ = tree
    skeleton = skeletonize(points, labels, method=method, voxel_size_m=0.01)
    assert skeleton.parent[0] == -1 and len(skeleton) > 100
    lost = 0.05 if method == "limbs" else 0.2  # the contraction shortens what ends
    assert np.ptp(skeleton.points[:, 2]) == pytest.approx(1.2, abs=lost)


@pytest.mark.parametrize("cloud", [np.empty((0, 3)), np.full((9, 3), np.nan)])
def test_points_that_are_none_are_refused(cloud):
    for call in (contract, skeletonize):
        with pytest.raises(ValueError, match="finite, and there must be some"):
            call(cloud)
