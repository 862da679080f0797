"""Contraction on shapes whose axis is known."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from skeleton_shapes import (
    labelled_cloud,
    sample_axes,
    small_tree,
    tube,
)

from cherrypicker.contraction.contract_points import SkeletonOptions, contract_points
from cherrypicker.contraction.contract_wood import contract_wood
from cherrypicker.contraction.laplacian_published import (
    cotangent_laplacian,
    semantic_row_weights,
)
from cherrypicker.errors import StageError
from cherrypicker.wood.thinned import GrowthOptions


@pytest.fixture(scope="module")
def cylinder():
    return tube((0, 0, 0), (0, 0, 0.5), 0.04, 12_000, rng=np.random.default_rng(1))


def test_laplacian_is_positive_semi_definite(cylinder):
    L, mass = cotangent_laplacian(cylinder)
    np.testing.assert_allclose(L.sum(axis=1), 0, atol=1e-8)
    x = np.random.default_rng(0).normal(size=len(cylinder))
    assert x @ (L @ x) > 0 and (mass > 0).all()
    assert mass.sum() == pytest.approx(2 * np.pi * 0.04 * 0.5, rel=0.25)


def test_semantic_rows_take_the_smallest_weight_around_them():
    # a chain of six points: three classes with weights 10, 1 and 5
    rows = [0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 5, 5]
    columns = [0, 1, 0, 1, 2, 1, 2, 3, 2, 3, 4, 3, 4, 5, 4, 5]
    L = csr_matrix((np.ones(16), (rows, columns)))
    weights = semantic_row_weights(L, np.array([10.0, 10, 1, 5, 5, 5]))
    np.testing.assert_array_equal(weights, [10, 1, 1, 1, 5, 5])


def test_semantic_rows_of_isolated_points_keep_their_weight():
    L = csr_matrix((3, 3))
    np.testing.assert_array_equal(semantic_row_weights(L, np.array([10.0, 1, 5])), [10, 1, 5])


def test_cylinder_contracts_to_its_axis(cylinder):
    result = contract_points(cylinder, None, SkeletonOptions("slbc", max_iterations=6))
    assert np.isfinite(result.points).all() and result.points.shape == cylinder.shape
    inner = (result.points[:, 2] > 0.1) & (result.points[:, 2] < 0.4)
    away = np.linalg.norm(result.points[inner, :2], axis=1)
    assert np.median(away) < 0.004  # a tenth of the radius
    assert result.mass_ratio == sorted(result.mass_ratio, reverse=True)


def test_contraction_does_not_depend_on_the_frame(cylinder):
    options = SkeletonOptions("slbc", max_iterations=3)
    here = contract_points(cylinder, None, options).points
    shift = np.array([365_000.0, 5_620_000.0, 310.0])
    there = contract_points(cylinder + shift, None, options).points - shift
    assert np.median(np.linalg.norm(here - there, axis=1)) < 1e-4


def test_heavier_trunk_contracts_further_past_a_hole():
    stem = tube((0, 0, 0), (0, 0, 0.6), 0.05, 12_000, rng=np.random.default_rng(5))
    stem = stem[np.linalg.norm(stem - (0.05, 0, 0.3), axis=1) > 0.06]
    options = SkeletonOptions("slbc", max_iterations=3)
    plain = contract_points(stem, None, options)
    heavy = contract_points(stem, np.full(len(stem), 10.0), options)

    def spread(result):
        z = result.points[:, 2]
        return np.linalg.norm(result.points[(z > 0.2) & (z < 0.4), :2], axis=1).mean()

    assert spread(heavy) < spread(plain)


def test_too_few_points_are_the_users_error():
    with pytest.raises(StageError, match="too few"):
        contract_points(np.zeros((3, 3)), None, SkeletonOptions())
    with pytest.raises(StageError, match="unknown method 'fastest' .*skeleton.method"):
        SkeletonOptions("fastest")


def test_weights_name_classes():
    with pytest.raises(StageError, match="unknown class"):
        SkeletonOptions(weights={"stem": 2.0})
    with pytest.raises(StageError, match="positive"):
        SkeletonOptions(weights={"trunk": 0.0})


def test_the_paper_takes_the_points_and_labels_as_they_are():
    points, labels, _ = small_tree()
    points, labels = points[::4], labels[::4]
    labels[750:763] = 2  # of the stem
    options = SkeletonOptions("slbc", {"trunk": 10.0, "branch": 3.0}, max_iterations=2)
    contracted, report = contract_wood(
        labelled_cloud(points, labels), GrowthOptions(voxel_size_m=1e-5), options=options
    )
    np.testing.assert_array_equal(contracted["source"], np.arange(len(points)))
    np.testing.assert_array_equal(contracted["label"], labels)
    weights = np.where(labels == 1, 10.0, 3.0)
    np.testing.assert_array_equal(
        contracted.points, contract_points(points, weights, options).points
    )
    assert report["n_contracted"] == len(points)


def test_wood_contracts_with_a_source_for_every_point():
    points, labels, axes = small_tree(noise=0.001)
    ground = np.random.default_rng(2).uniform((-1, -1, -0.01), (1, 1, 0.01), (2000, 3))
    cloud = labelled_cloud(np.vstack([points, ground]), np.concatenate([labels, np.zeros(2000)]))
    contracted, report = contract_wood(cloud, GrowthOptions(voxel_size_m=0.01))
    source = contracted["source"]
    assert source.dtype == np.int32 and len(np.unique(source)) == len(source)
    assert np.mean(cloud["label"][source] == contracted["label"]) > 0.99  # most of a voxel's points
    assert set(np.unique(contracted["label"])) == {1, 2}
    assert report["wood"]["n_stems"] == 1
    distance = np.linalg.norm(
        contracted.points[:, None, :] - sample_axes(axes, 0.02)[None], axis=2
    ).min(axis=1)
    assert np.mean(distance < 0.02) > 0.95


def test_cloud_without_wood_names_the_key():
    cloud = labelled_cloud(np.random.default_rng(0).random((500, 3)), np.zeros(500))
    with pytest.raises(StageError, match="0 points.*contract.classes"):
        contract_wood(cloud)
