"""The benchmark of traits: matching, scores and table, on trees and numbers with known answers."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from cherrypicker.errors import StageError
from cherrypicker.geometry.hulls import reach_around, width_of
from cherrypicker.skeleton import axes
from cherrypicker.traits.branches import branch_rows
from cherrypicker_lab.orchard.grow.growth import grow_tree
from cherrypicker_lab.orchard.truth import tree_traits
from cherrypicker_lab.traits.pairs import branch_pairs, make_tree, match_axes, tree_pairs
from cherrypicker_lab.traits.tables import gather, score_pairs, traits_figure, write_table


def line(start, end, n=20):
    return np.linspace(start, end, n)


def test_axes_match_by_where_they_run():
    true = [line([0, 0, 1], [1, 0, 1]), line([0, 0, 1.03], [0, 1, 1.03])]
    along_second = line([0, 0, 1.02], [0, 1, 1.04])
    along_first = line([0, 0, 1], [0.8, 0.01, 1])  # its last fifth was not found
    assert match_axes(true, [along_second, along_first]) == [(0, 1), (1, 0)]


@pytest.mark.parametrize(
    "found",
    [
        line([0, 0, 1], [0.6, 0, 1]),  # too little of it
        line([0.2, 0, 1], [1, 0, 1]),  # starts elsewhere
        line([0, 0, 1], [1, 0.2, 1]),  # runs off
    ],
)
def test_other_axes_do_not_match(found):
    assert match_axes([line([0, 0, 1], [1, 0, 1])], [found]) == []


def test_one_found_axis_stands_for_one_true_axis():
    true = [line([0, 0, 1], [1, 0, 1]), line([0, 0, 1.01], [1, 0, 1.01])]
    assert len(match_axes(true, [line([0, 0, 1], [1, 0, 1])])) == 1
    assert match_axes(true, []) == []


def test_the_true_skeleton_measures_without_error():
    tree = grow_tree(3, "spindle")
    skeleton = tree.skeleton()
    rows = branch_rows(skeleton, axes(skeleton), 0.0)
    pairs, n_axes, n_matched = branch_pairs(tree, skeleton, rows)
    assert n_axes == n_matched == sum(row["length_m"] >= 0.1 for row in rows[1:])
    assert len(pairs["insertion_angle_deg"]) == n_matched
    assert all(pair["true"] >= 0.010 for pair in pairs["base_diameter_m"])
    assert 0 < len(pairs["base_diameter_m"]) < n_matched
    for pair in pairs["base_diameter_m"] + pairs["insertion_angle_deg"]:
        assert pair["found"] == pair["true"]


def test_traits_of_the_whole_tree_beside_the_truth():
    tree = grow_tree(3, "vase")
    true = tree_traits(tree)
    width = width_of(reach_around(tree.skeleton().points[:, :2]))
    found = true | {"crown_width_m": width + 0.1, "height_m_ci90": [1.0, 3.0]}
    found |= {"crown_volume_m3": 1.0, "limb_trunk_ratio": 1.0}
    pairs = tree_pairs(tree, found)
    assert pairs["height_m"] == [
        {"true": true["height_m"], "found": true["height_m"], "low": 1.0, "high": 3.0}
    ]
    (width_pair,) = pairs["crown_width_m"]
    # the true width is the surface's: a radius of 1 to 5 mm beyond either end of the skeleton
    assert 0.090 < width_pair["found"] - width_pair["true"] < 0.098
    assert width_pair["low"] is None
    (volume_pair,) = pairs["crown_volume_m3"]
    whole = ConvexHull(tree.skeleton().points).volume  # from the foot on, but without radii
    assert 0.5 * whole < volume_pair["true"] < 1.1 * whole


def test_the_cloud_is_the_targets_and_repeats():
    tree, cloud = make_tree(6001, 12_000)
    assert tree.habit == "spindle"  # the forms take turns
    assert "tree" not in cloud
    again = make_tree(6001, 12_000)[1]
    assert np.array_equal(cloud.points, again.points)
    reach = np.linalg.norm(tree.skeleton().points[:, :2], axis=1).max()
    wood = cloud.points[np.isin(cloud["label"], (1, 2))]
    assert np.quantile(np.linalg.norm(wood[:, :2], axis=1), 0.99) < reach + 0.05


def test_bearing_trees_have_stems_of_10_to_20_cm():
    for seed in (6000, 6001):
        tree, cloud = make_tree(seed, 12_000, bearing=True)
        assert tree.habit == ("bearing_leader", "bearing_vase")[seed % 2]
        assert 0.095 < tree_traits(tree)["trunk_diameter_m"] < 0.21
        assert 0.5 <= tree.relief <= 1.0
        reach = np.linalg.norm(tree.skeleton().points[:, :2], axis=1).max()
        assert reach < 2.5  # what lies farther out is not sampled


def pair(true, found, low=None, high=None):
    return {"true": true, "found": found, "low": low, "high": high}


def report(seed):
    names = ("trunk_diameter_m", "base_diameter_m", "insertion_angle_deg", "crown_width_m")
    names = (*names, "crown_volume_m3", "total_length_m", "limb_trunk_ratio")
    traits = {name: [pair(0.100, 0.102)] for name in names}
    traits["height_m"] = [pair(2.00, 1.98, 1.97, 1.99), pair(2.00, 2.01, 1.99, 2.03)]
    return {"seed": seed, "n_points": 1000, "traits": traits, "n_axes": 10, "n_matched": 8}


def test_scores():
    score = score_pairs(gather([report(1), report(2)])["height_m"])
    assert score["n"] == 4
    assert score["mae"] == pytest.approx(0.015)
    assert score["bias"] == pytest.approx(-0.005)
    assert (score["n_intervals"], score["coverage"]) == (4, 0.5)
    assert score["width"] == pytest.approx(0.03)
    assert score_pairs(gather([report(1)])["crown_width_m"])["coverage"] is None


def test_table_and_figure():
    reports = [report(1), report(2)]
    text = write_table(reports)
    assert "2 trees, seeds 1 to 2" in text
    assert "16 of 20 axes" in text
    assert "| height | cm | 4 | 1.50 | 2 | -0.50 | 2 of 4 (50 %) | 3.00 |" in text
    assert "| crown width | cm | 2 | 0.20 |  | +0.20 | none given |  |" in text
    assert len(traits_figure(reports).axes) == 8
    mixed = write_table([report(1), report(9) | {"bearing": True}])
    assert "1 trees, seeds 1 to 1" in mixed and "1 bearing trees, seeds 9 to 9" in mixed
    assert mixed.count("| height | cm | 2 | 1.50 |") == 2
    with pytest.raises(StageError, match="no tree"):
        write_table([])
