"""Graphs and radii on trees whose skeleton is known."""

import networkx as nx
import numpy as np
import pytest
from scipy.spatial import cKDTree
from skeleton_shapes import (
    labelled_cloud,
    old_cherry,
    sample_axes,
    sample_skeleton,
    small_tree,
)

from cherrypicker.contraction.contract_points import SkeletonOptions
from cherrypicker.contraction.contract_wood import contract_wood
from cherrypicker.errors import StageError
from cherrypicker.geometry.neighbors import Neighbors, component_links, components
from cherrypicker.graph.extract import extract_skeleton
from cherrypicker.graph.spanning_tree import spanning_tree
from cherrypicker.limbs.files import read_orchard, write_orchard
from cherrypicker.limbs.growth import grow_limbs
from cherrypicker.limbs.orchard import grow_orchard
from cherrypicker.skeleton import axes, fold
from cherrypicker.wood.thinned import GrowthOptions


def way(*corners, step=0.002, jitter=0.0005, seed=0):
    """Points along a polyline, as a good contraction leaves them."""
    rng = np.random.default_rng(seed)
    pieces = []
    for a, b in zip(np.array(corners[:-1], float), np.array(corners[1:], float)):
        n = int(np.linalg.norm(b - a) / step)
        pieces.append(a + np.linspace(0, 1, n)[:, None] * (b - a))
    points = np.vstack(pieces)
    return points + rng.normal(0, jitter, points.shape)


def limb_tree(points, labels):
    cloud = labelled_cloud(points, labels).with_fields(source=np.arange(len(points)))
    limbs = grow_limbs(points, (0, 0, 0), stem=labels == 1)
    return extract_skeleton(cloud, cloud, limbs=limbs)


def graph_of(skeleton):
    graph = nx.Graph()
    graph.add_nodes_from(range(len(skeleton)))
    graph.add_edges_from((int(p), n) for n, p in enumerate(skeleton.parent) if p >= 0)
    return graph


def test_y_has_one_junction_and_two_tips():
    points = np.vstack(
        [
            way((0, 0, 0), (0, 0, 0.5)),
            way((0, 0, 0.5), (0.3, 0, 0.9), seed=1),
            way((0, 0, 0.5), (-0.3, 0, 0.8), seed=2),
        ]
    )
    labels = np.where(points[:, 2] < 0.5, 1, 2)
    skeleton = spanning_tree(points, labels, spacing_m=0.02)
    assert nx.is_tree(graph_of(skeleton))
    assert skeleton.points[0, 2] < 0.01
    lengths = [length for *_, length in fold(skeleton).edges(data="length")]
    assert sum(length > 0.05 for length in lengths) == 3
    assert skeleton.edge_length.sum() == pytest.approx(0.5 + 0.5 + 0.424, rel=0.08)


def test_pieces_far_apart_still_make_one_tree():
    points = np.vstack(
        [way((0, 0, 0), (0, 0, 0.5)), way((0, 0, 0.62), (0, 0, 1.0)), way((0.4, 0, 1), (0.6, 0, 1))]
    )
    skeleton = spanning_tree(points, np.ones(len(points), dtype=int), spacing_m=0.02)
    assert nx.is_tree(graph_of(skeleton))
    assert skeleton.fields["gap"].sum() >= 2


def test_components_are_joined_by_their_shortest_links():
    points = np.array([[0, 0, 0], [1, 0, 0], [5, 0, 0], [6, 0, 0], [6, 9, 0], [6, 10, 0]], float)
    edges = np.array([[0, 1], [2, 3], [4, 5]])
    links = component_links(points, edges)
    assert {tuple(link) for link in links} == {(1, 2), (3, 4)}
    assert components(6, np.vstack([edges, links]))[1] == 1
    assert len(component_links(points, edges, max_distance=5.0)) == 1
    assert Neighbors(points, 1).touching(1, np.inf)[0].tolist() == edges.tolist()


def test_root_is_the_stems_foot_not_the_lowest_branch():
    branch = way((0, 0, 0.5), (0.8, 0, -0.2))
    points = np.vstack([way((0, 0, 0.1), (0, 0, 0.5)), branch])
    is_branch = np.arange(len(points)) >= len(points) - len(branch)
    by_label = spanning_tree(points, np.where(is_branch, 2, 1), spacing_m=0.02)
    by_base = spanning_tree(points, np.full(len(points), 2), spacing_m=0.02, base=(0, 0, 0.2))
    for skeleton in (by_label, by_base):
        np.testing.assert_allclose(skeleton.points[0], (0, 0, 0.1), atol=0.01)


def test_too_few_or_coinciding_points():
    with pytest.raises(StageError, match="too few"):
        spanning_tree(np.zeros((30, 3)), np.ones(30, dtype=int))
    with pytest.raises(StageError, match="too few"):
        spanning_tree(np.array([[0, 0, 0], [0, 0, 0.001]]), np.ones(2, dtype=int), spacing_m=0.01)


@pytest.fixture(scope="module")
def tree_case():
    """The contracted points of a small tree, its surface cloud, its limbs and its true axes."""
    points, labels, true_axes = small_tree(3, noise=0.001)
    cloud = labelled_cloud(points, labels)
    contracted, report = contract_wood(cloud)
    return contracted, cloud, report["limbs"], true_axes


@pytest.mark.parametrize("method", ["slbc", "limbs"])
def test_extracted_tree_is_the_true_one(tree_case, method):
    contracted, cloud, limbs, true_axes = tree_case
    limbs = limbs if method == "limbs" else None
    skeleton = extract_skeleton(contracted, cloud, base=(0, 0, 0), limbs=limbs)
    assert nx.is_tree(graph_of(skeleton)) and np.isfinite(skeleton.points).all()
    true, found = sample_axes(true_axes), sample_skeleton(skeleton)
    assert (cKDTree(found).query(true)[0] < 0.02).mean() > 0.97
    assert (cKDTree(true).query(found)[0] < 0.02).mean() > 0.97
    assert skeleton.points[0, 2] < 0.05


def test_tree_solver_finds_the_branches_and_their_radii(tree_case):
    contracted, cloud, limbs, true_axes = tree_case
    skeleton = extract_skeleton(contracted, cloud, limbs=limbs)
    found = axes(skeleton)
    assert sorted(axis.order for axis in found) == [0, 1, 1, 1, 1, 2]
    n_children = skeleton.n_children
    assert np.count_nonzero(n_children == 0) == 6
    feet = np.array([start for start, *_ in true_axes[1:]])
    junctions = skeleton.points[n_children > 1]
    assert len(junctions) == 5
    assert cKDTree(junctions).query(feet)[0].max() < 0.02
    trunk = found[0].nodes
    z = skeleton.points[trunk, 2]
    stem = (z > 0.1) & (z < 1.1)
    expected = 0.03 - 0.018 * z / 1.2
    assert np.abs(skeleton.radius[trunk] - expected)[stem].max() < 0.003
    assert skeleton.points[:, 2].max() > 1.17


def wood_beside_wood(skeleton, near=0.03, apart=0.15):
    """Share of the edges that other wood runs along: near, but far along the skeleton."""
    ends = np.stack([skeleton.parent[1:], np.arange(1, len(skeleton))], axis=1)
    middle = skeleton.points[ends].mean(axis=1)
    step = np.diff(skeleton.points[ends], axis=1)[:, 0]
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    pairs = cKDTree(middle).query_pairs(near, output_type="ndarray")
    pairs = pairs[np.abs((step[pairs[:, 0]] * step[pairs[:, 1]]).sum(axis=1)) > 0.9]
    tree = graph_of(skeleton)
    for parent, node in ends:
        tree.edges[parent, node]["way"] = skeleton.edge_length[node]
    beside = {
        edge
        for one, other in pairs
        if nx.dijkstra_path_length(tree, ends[one, 1], ends[other, 1], "way") > apart
        for edge in (one, other)
    }
    return len(beside) / len(ends)


@pytest.mark.parametrize(("voxel_size_m", "labels_known"), [(0.008, False), (0.005, True)])
def test_a_thick_tree_of_rough_bark_has_one_axis_a_limb(voxel_size_m, labels_known):
    points, labels, true_axes = old_cherry()
    cloud = labelled_cloud(points, labels if labels_known else np.full(len(labels), 2))
    contracted, report = contract_wood(cloud, GrowthOptions(voxel_size_m=voxel_size_m))
    skeleton = extract_skeleton(contracted, cloud, limbs=report["limbs"])
    n_children = skeleton.n_children
    assert np.count_nonzero(n_children == 0) == len(true_axes)  # no strand, no whisker
    assert wood_beside_wood(skeleton) == 0
    junctions = skeleton.points[n_children > 1]
    around = cKDTree(junctions).query_ball_point(junctions, 0.04, return_length=True)
    assert around.max() <= 2  # no knot
    found, true = sample_skeleton(skeleton), sample_axes(true_axes)
    assert (cKDTree(found).query(true)[0] < 0.03).mean() > 0.95
    assert np.quantile(cKDTree(true).query(found)[0], 0.97) < 0.025  # a fork may pull at the stem


def test_equal_input_gives_equal_skeletons(tree_case):
    contracted, cloud, limbs, _ = tree_case
    first, second = (extract_skeleton(contracted, cloud, limbs=limbs) for _ in range(2))
    np.testing.assert_array_equal(first.points, second.points)
    np.testing.assert_array_equal(first.radius, second.radius)


def test_limbs_are_grown_once_and_joined_from_their_file(tree_case, tmp_path):
    _, cloud, *_ = tree_case
    orchard = grow_orchard(cloud)
    contracted, report = contract_wood(cloud, orchard=orchard)
    write_orchard(tmp_path / "limbs.npz", orchard)
    read = read_orchard(tmp_path / "limbs.npz")
    stored = read.limbs_of(report["stem"], contracted["source"])
    np.testing.assert_array_equal(read.owner, orchard.owner)
    alone, joined = (
        extract_skeleton(contracted, cloud, limbs=limbs) for limbs in (report["limbs"], stored)
    )
    np.testing.assert_array_equal(alone.points, joined.points)
    np.testing.assert_array_equal(alone.parent, joined.parent)
    np.testing.assert_array_equal(alone.radius, joined.radius)
    fewer = contracted.select(np.arange(100))
    with pytest.raises(StageError, match="for a tree of 100"):
        extract_skeleton(fewer, cloud, limbs=stored)


def test_a_published_contraction_leaves_the_limbs_to_the_graph(tree_case):
    _, cloud, *_ = tree_case
    options = SkeletonOptions("slbc", max_iterations=1)
    _, report = contract_wood(cloud, GrowthOptions(voxel_size_m=0.01), options=options)
    assert report["limbs"] is None


def test_a_part_of_a_cloud_keeps_its_limbs(tree_case):
    _, cloud, *_ = tree_case
    orchard = grow_orchard(cloud)
    rows = np.flatnonzero(np.arange(len(cloud)) % 3 > 0)
    part = orchard.select(rows)
    contracted, report = contract_wood(cloud.select(rows), orchard=part)
    assert len(report["limbs"].limbs) == len(orchard.limbs[report["stem"]].limbs)
    whole, _ = contract_wood(cloud, orchard=orchard)
    kept = np.isin(whole["source"], rows)
    np.testing.assert_array_equal(rows[contracted["source"]], whole["source"][kept])
    np.testing.assert_allclose(contracted.points, whole.points[kept], atol=1e-6)


def test_trunk_ends_once_and_begins_at_the_root():
    """Wrong labels here and there neither end the trunk early nor begin one on a branch."""
    points, labels, _ = small_tree(5, noise=0.001)
    wrong = np.random.default_rng(1).random(len(labels)) < 0.1
    labels = np.where(wrong, 3 - labels, labels)
    skeleton = limb_tree(points, labels)
    trunk = skeleton.label == 1
    assert trunk[0] and not (trunk[1:] & ~trunk[skeleton.parent[1:]]).any()
    aside = np.linalg.norm(skeleton.points[:, :2], axis=1)
    assert trunk[aside < 0.01].mean() > 0.97 and not trunk[aside > 0.06].any()


def test_an_edge_over_missing_data_says_so():
    points, labels, _ = small_tree(5, noise=0.001)
    seen = (points[:, 2] < 0.2) | (points[:, 2] > 0.4)
    points, labels = points[seen], labels[seen]
    skeleton = limb_tree(points, labels)
    z = skeleton.points[:, 2]
    assert skeleton.fields["gap"][(z > 0.27) & (z < 0.33)].all()
    assert skeleton.fields["gap"][z > 0.45].mean() < 0.02
