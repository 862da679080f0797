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
from cherrypicker_lab.traits.benchmark import judge_limbs
from cherrypicker_lab.traits.cases import true_scaffold, whole_truth
from cherrypicker_lab.traits.pairs import make_tree, match_axes, matched_rows
from cherrypicker_lab.traits.tables import score, write_table


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
    matched = matched_rows(skeleton, skeleton, rows)
    assert len(matched) == sum(row["length_m"] >= 0.1 for row in rows[1:])
    assert all(true["branch_id"] == found["branch_id"] for true, found in matched)


def test_whole_trees_truth_is_the_surfaces():
    tree = grow_tree(3, "vase")
    skeleton = tree.skeleton()
    true, grown = whole_truth(skeleton), tree_traits(tree)
    assert true["height_m"] == grown["height_m"]
    assert true["trunk_diameter_m"] == pytest.approx(grown["trunk_diameter_m"], abs=1e-9)
    # a radius of 1 to 5 mm beyond either end of the skeleton
    width = width_of(reach_around(skeleton.points[:, :2]))
    assert 0.002 < true["crown_width_m"] - width < 0.010
    whole = ConvexHull(skeleton.points).volume  # from the foot on, but without radii
    assert 0.5 * whole < true["crown_volume_m3"] < 1.1 * whole


def test_the_true_limbs_are_found_and_a_missing_one_is_told():
    skeleton = grow_tree(3, "spindle").skeleton()
    limbs = sorted(true_scaffold(skeleton).limbs, key=lambda limb: -limb.diameter)
    ends = ("diameter_m", "diameter_low_m", "diameter_high_m")
    rows = [{"branch_id": x.axis} | dict.fromkeys(ends, x.diameter) for x in limbs]
    found = judge_limbs(limbs, skeleton, rows)
    assert found["n_true"] == found["n_found"] == len(found["diameters"]) == len(limbs)
    assert found["are_three"] and found["are_three_to_2mm"]
    assert all(pair["found"] == pair["true"] for pair in found["diameters"])
    without = judge_limbs(limbs, skeleton, rows[1:])
    assert without["n_found"] == len(without["diameters"]) == len(limbs) - 1
    assert not without["are_three"]
    assert judge_limbs(limbs, skeleton, [])["diameters"] == []


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


def report(seed, source="thin"):
    names = ("trunk_diameter_m", "base_diameter_m", "insertion_angle_deg", "crown_width_m")
    names = (*names, "crown_volume_m3", "total_length_m", "limb_trunk_ratio")
    cases = [{"trait": name, **pair(0.100, 0.102)} for name in names]
    cases += [
        {"trait": "height_m", **each}
        for each in (pair(2.00, 1.98, 1.97, 1.99), pair(2.00, 2.01, 1.99, 2.03))
    ]
    limbs = {"n_true": 4, "n_found": 3, "are_three": True, "are_three_to_2mm": True}
    limbs["diameters"] = [pair(0.020, 0.021, 0.019, 0.022)] * 3
    return {"source": source, "seed": seed, "cases": cases, "limbs": limbs}


def test_scores():
    scores = score([pair(2.0, 1.98, 1.97, 1.99), pair(2.0, 2.01, 1.99, 2.03)] * 2)
    assert scores["n"] == 4
    assert scores["mae"] == pytest.approx(0.015)
    assert scores["bias"] == pytest.approx(-0.005)
    assert (scores["n_intervals"], scores["n_held"]) == (4, 2)
    assert scores["width"] == pytest.approx(0.03)
    assert score([pair(1.0, 1.1)])["n_intervals"] == score([])["n"] == 0


def test_table():
    reports = [report(1), report(2)]
    text = write_table(reports)
    assert "2 thin trees, seeds 1 to 2." in text
    assert "| height | cm | 4 | 1.50 | -0.50 | 2 of 4 (50 %) | 3.00 |" in text
    assert "| crown width | cm | 2 | 0.20 | +0.20 | none given |  |" in text
    assert "6 limbs were found, 8 are true, 6 were matched: diameter's MAE 1.00 mm" in text
    assert "true three on 2 of 2 trees" in text
    mixed = write_table([report(1), report(9, "bearing")])
    assert "1 thin trees, seeds 1 to 1." in mixed and "1 bearing trees, seeds 9 to 9." in mixed
    assert mixed.count("| height | cm | 2 | 1.50 |") == 2
    with pytest.raises(StageError, match="no tree"):
        write_table([])
