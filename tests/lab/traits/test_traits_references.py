"""Results beside reference measures of real trees, on a tree with known answers."""

import numpy as np
import pytest

from cherrypicker.errors import StageError
from cherrypicker.files import write_json
from cherrypicker.skeleton import axes, read_skeleton_csv, write_skeleton_graphml
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.branches import branch_rows, branches_csv
from cherrypicker_lab.traits.references import (
    compare_results,
    read_reference_table,
    skeleton_measures,
)
from cherrypicker_lab.traits.tables import write_table


def small_skeleton():
    """A stem of 2 m that tapers from 3 to 1 cm of radius, and a lateral of 0.5 m at 90 degrees."""
    stem = np.column_stack([np.zeros(41), np.zeros(41), np.linspace(0.5, 2.5, 41)])
    side = np.column_stack([np.linspace(0.05, 0.5, 10), np.zeros(10), np.full(10, 1.5)])
    parent = np.concatenate([np.arange(-1, 40), [20], np.arange(41, 50)])
    radius = np.concatenate([np.linspace(0.03, 0.01, 41), np.full(10, 0.008)])
    return Skeleton(np.vstack([stem, side]), parent, radius, np.full(51, 2))


def write_reference(path, skeleton, *, order=None, without=()):
    order = range(len(skeleton)) if order is None else order
    lines = ["id,parent,x,y,z,radius"]
    for node in order:
        parent = skeleton.parent[node]
        x, y, z = skeleton.points[node]
        radius = "" if node in without else skeleton.radius[node]
        lines.append(f"{node + 7},{parent + 7 if parent >= 0 else -1},{x},{y},{z},{radius}")
    path.write_text("\n".join(lines) + "\n")


def write_results(folder, skeleton):
    """Results that found all, but the height 4 cm too great and diameters 2 mm too great."""
    folder.mkdir()
    found = {
        "height_m": 2.04,
        "height_m_ci90": [1.99, 2.05],
        "crown_width_m": 0.5,
        "total_length_m": 2.5,
        "trunk_height_m": 0.5,
        "trunk_diameter_m": 0.052,
        "trunk_diameter_m_ci90": [0.051, 0.053],
        "trunk_diameters": {"1.00": 0.042},
        "trunk_diameters_se": {"1.00": 0.002},
    }
    write_json(folder / "traits.json", found)
    write_skeleton_graphml(folder / "skeleton.graphml", skeleton)
    rows = branch_rows(skeleton, axes(skeleton), 0.5)
    (folder / "branches.csv").write_text(branches_csv(rows))


def test_a_tape_and_a_caliper_in_any_unit(tmp_path):
    table = tmp_path / "tape.csv"
    table.write_text(
        "name,trait,value,unit\nold,height_m,231,cm\nold,trunk_diameter_m@1.3,48,mm\n"
        "new,trunk_diameter_m,0.03,m\n"
    )
    assert read_reference_table(table) == {
        "old": {"height_m": pytest.approx(2.31), "trunk_diameter_m@1.3": pytest.approx(0.048)},
        "new": {"trunk_diameter_m": 0.03},
    }


@pytest.mark.parametrize(
    "row", ["a,hight_m,2,m", "a,height_m,2,inch", "a,height_m,two,m", "a,height_m@1,2,m", "a,b"]
)
def test_a_bad_row_is_named(tmp_path, row):
    table = tmp_path / "tape.csv"
    table.write_text(f"name,trait,value,unit\n{row}\n")
    with pytest.raises(StageError, match=r"row"):
        read_reference_table(table)


def test_a_reference_skeleton_in_any_order(tmp_path):
    true = small_skeleton()
    path = tmp_path / "tree.csv"
    write_reference(path, true, order=np.random.default_rng(0).permutation(len(true)), without=[30])
    read = read_skeleton_csv(path)
    assert read.edge_length.sum() == pytest.approx(true.edge_length.sum())
    z = read.points[:, 2]
    (bare,) = np.flatnonzero(np.isclose(z, 2.0) & np.isclose(read.points[:, 0], 0))
    assert read.radius[bare] == pytest.approx(true.radius[29])  # its parent's


def test_measures_of_a_skeleton():
    measures = skeleton_measures(small_skeleton(), [1.0, 3.0])
    assert measures["height_m"] == pytest.approx(2.0)
    assert measures["total_length_m"] == pytest.approx(2.5)
    assert measures["trunk_diameter_m@1"] == pytest.approx(0.04)
    assert "trunk_diameter_m@3" not in measures  # the stem ends below


def test_pairs_with_known_errors(tmp_path):
    true = small_skeleton()
    write_results(tmp_path / "tree", true)
    write_reference(tmp_path / "tree.csv", true)
    report = compare_results(tmp_path / "tree", {"height_m": 2.02}, tmp_path / "tree.csv")
    assert (report["n_axes"], report["n_matched"]) == (1, 1)
    (height,) = report["traits"]["height_m"]  # the tape comes before the skeleton
    assert height == {"true": 2.02, "found": 2.04, "low": 1.99, "high": 2.05}
    errors = [p["found"] - p["true"] for p in report["traits"]["trunk_diameter_m"]]
    assert errors == pytest.approx([0.002, 0.002])
    further = report["traits"]["trunk_diameter_m"][0]
    assert further["high"] - further["low"] == pytest.approx(2 * 1.645 * 0.002)
    (angle,) = report["traits"]["insertion_angle_deg"]
    assert angle["found"] == pytest.approx(angle["true"], abs=0.01)
    text = write_table([report])
    assert "1 trees (tree); 1 of 1 axes" in text
    assert "| trunk diameter | mm | 2 | 2.00 | 3 | +2.00 | 1 of 2 (50 %)" in text
    assert "| height | cm | 1 | 2.00 | 2 | +2.00 | 1 of 1 (100 %)" in text


def test_a_tape_alone_asks_for_no_branches(tmp_path):
    write_results(tmp_path / "tree", small_skeleton())
    report = compare_results(tmp_path / "tree", {"trunk_diameter_m": 0.05})
    assert report["n_axes"] == 0
    assert "| height | cm | 0 |" in write_table([report])
    with pytest.raises(StageError, match="no reference measure"):
        compare_results(tmp_path / "tree")


def test_wider_tolerances_match_more(tmp_path):
    true = small_skeleton()
    shifted = Skeleton(true.points + (0.0, 0.04, 0.0), true.parent, true.radius, true.label)
    write_results(tmp_path / "tree", shifted)
    write_reference(tmp_path / "tree.csv", true)
    assert compare_results(tmp_path / "tree", None, tmp_path / "tree.csv")["n_matched"] == 0
    wide = compare_results(tmp_path / "tree", None, tmp_path / "tree.csv", near_m=0.05, base_m=0.1)
    assert wide["n_matched"] == 1
