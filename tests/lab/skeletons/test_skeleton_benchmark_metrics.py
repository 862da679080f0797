"""The benchmark's measures on trees whose answer is known."""

import numpy as np
import pytest

from cherrypicker.skeleton.model import Skeleton
from cherrypicker_lab.skeletons.distances import chamfer_cm2, match_rates, matched_pairs
from cherrypicker_lab.skeletons.graph_scores import (
    Graph,
    false_edges,
    graph_of,
    radius_errors,
    score_graph,
    score_points,
    ways_to_root,
)
from cherrypicker_lab.skeletons.true_tree import TrueTree


def fork():
    """A stem of 1 m with nodes every 10 cm, two level branches of 40 cm at z = 0.5 and 0.55."""
    stem = np.stack([np.zeros(11), np.zeros(11), np.arange(11) / 10], axis=1)
    out = np.arange(1, 5) / 10
    low = np.stack([out, np.zeros(4), np.full(4, 0.5)], axis=1)
    high = np.stack([out, np.zeros(4), np.full(4, 0.6)], axis=1)
    points = np.vstack([stem, low, high])
    parent = np.concatenate([np.arange(-1, 10), [5, 11, 12, 13], [6, 15, 16, 17]])
    order = np.repeat([0, 1], [11, 8])
    radius = np.concatenate([np.full(11, 0.02), np.tile([0.01, 0.008, 0.006, 0.003], 2)])
    return Skeleton(points, parent, radius, order + 1, {"order": order})


@pytest.fixture(scope="module")
def truth():
    return TrueTree(fork())


def test_chamfer_adds_both_mean_squares():
    truth = np.array([[0.0, 0, 0], [1, 0, 0]])
    found = np.array([[0.0, 0, 0.03], [0, 0, 0.01]])
    # there: (9 + 1) / 2; back: 1 from the first, 100^2 + 1 from the second
    assert chamfer_cm2(found, truth) == pytest.approx(5 + (1 + 10001) / 2)
    assert chamfer_cm2(truth, truth) == 0


def test_matches_are_one_to_one_and_as_many_as_can_be():
    truth = np.array([[0.0, 0, 0], [0.04, 0, 0]])
    # the first is nearest to both; taking it for the nearest only would lose the other
    found = np.array([[0.03, 0, 0], [0.06, 0, 0], [0.061, 0, 0]])
    assert len(matched_pairs(found, truth, 0.05)) == 2
    rates = match_rates(found, truth, 0.05)
    assert rates["precision"] == pytest.approx(2 / 3) and rates["recall"] == 1
    assert len(matched_pairs(truth, truth, 0.05)) == 2  # at distance 0
    assert match_rates(np.empty((0, 3)), truth, 0.05)["f1"] == 0


def test_ways_along_the_tree(truth):
    ends = truth.tree.query([[0.4, 0, 0.5], [0.4, 0, 0.6], [0, 0, 1], [0, 0, 0]])[1]
    assert truth.way(ends[:1], ends[1:2])[0] == pytest.approx(0.9)
    assert truth.way(ends[:1], ends[2:3])[0] == pytest.approx(0.9)
    assert truth.way(ends[3:], ends[2:3])[0] == pytest.approx(1.0)
    np.testing.assert_allclose(truth.depth[ends], [0.9, 1.0, 1.0, 0], atol=1e-12)
    assert len(truth.fine) > 350 and truth.fine.edge_length.max() < 0.0051


def test_the_truth_itself_scores_full_marks(truth):
    report = score_graph(graph_of(fork()), truth)
    assert report["junctions"]["f1"] == 1 and report["junctions"]["n_true"] == 2
    assert report["tips"]["f1"] == 1 and report["tips"]["n_true"] == 3
    assert report["n_false_edges"] == 0 and report["length_error"] == pytest.approx(0)
    assert report["ways_within_10pct"] == 1


def test_a_join_between_branches_is_false(truth):
    graph = graph_of(fork())
    ends = [int(np.argmin(np.linalg.norm(graph.points - p, axis=1)))
            for p in ([0.4, 0, 0.5], [0.4, 0, 0.6])]  # fmt: skip
    graph = Graph(graph.points, np.vstack([graph.edges, [ends]]))
    np.testing.assert_array_equal(np.flatnonzero(false_edges(graph, truth)), [len(graph.edges) - 1])
    report = score_graph(graph, truth)
    assert report["n_false_edges"] == 1 and report["tips"]["recall"] < 1


def test_a_branch_on_the_wrong_way_to_the_root(truth):
    graph = graph_of(fork())
    # the low branch hangs on the high one's tip: its nodes' ways are far too long
    low = np.flatnonzero((graph.points[:, 0] > 0) & (graph.points[:, 2] < 0.55))
    low = low[np.argsort(graph.points[low, 0])]
    high_tip = int(np.argmin(np.linalg.norm(graph.points - [0.4, 0, 0.6], axis=1)))
    cut = (graph.edges == low[0]).any(axis=1) & (graph.points[graph.edges][:, :, 0].min(1) == 0)
    edges = np.vstack([graph.edges[~cut], [[high_tip, low[-1]]]])
    good = ways_to_root(Graph(graph.points, edges), truth)
    np.testing.assert_array_equal(np.flatnonzero(~good), np.sort(low))
    loose = ways_to_root(Graph(graph.points, graph.edges[~cut]), truth)
    np.testing.assert_array_equal(np.flatnonzero(~loose), np.sort(low))


def test_a_missing_branch_lowers_recall_and_length(truth):
    skeleton = fork()
    keep = ~((skeleton.points[:, 0] > 0) & (skeleton.points[:, 2] > 0.55))
    report = score_graph(graph_of(skeleton.select(keep)), truth)
    assert report["tips"]["recall"] == pytest.approx(2 / 3)
    assert report["length_error"] == pytest.approx(-0.4 / 1.8)


def test_errors_of_the_radius_by_thickness(truth):
    found = fork()
    found.radius[:11] += 0.002
    found.radius[[13, 17]] -= 0.001  # the 6 mm of both branches
    found.points[[14, 18]] += [0, 0.1, 0]  # their tips, which are thinner than 4 mm
    errors = radius_errors(found.points, found.radius, truth)
    assert errors == pytest.approx({"4_to_12mm": 0.0, "above_12mm": 0.002})


def test_points_beside_the_truth():
    skeleton = fork()
    (chamfer,) = score_points(skeleton.points + [0, 0.019, 0], skeleton).values()
    assert 3.61 + 3.61 < chamfer < 3.61 + 3.61 + 5**2  # nodes stand every 10 cm
