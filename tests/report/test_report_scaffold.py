"""The limbs' section of a tree's page: its table, and what is left when limbs are clicked away."""

import json
import re

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from cherrypicker.errors import StageError
from cherrypicker.report.scaffold import limb_section
from cherrypicker.report.text import page_template
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.branches import branch_rows, branches_csv, read_branches
from cherrypicker.traits.limb_table import limb_rows
from cherrypicker.traits.scaffold import Scaffold
from cherrypicker.traits.table import LIMB_COLUMNS

STEM_M, N_STEM, N_LIMB = 0.10, 81, 31


def tree():
    """A stem with four limbs of falling radius, one above the other."""
    stem = np.linspace([0, 0, 0], [0, 0, 2.4], N_STEM)
    points, parent, radius = [*stem], [-1, *range(N_STEM - 1)], [STEM_M / 2] * N_STEM
    for at, (turn, thick) in enumerate([(0, 0.02), (100, 0.015), (200, 0.01), (290, 0.008)]):
        node = 25 + 10 * at
        way = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn)), 0.3 + 0.1 * at])
        first = len(points)
        points += [*(stem[node] + np.linspace(0.03, 0.9, N_LIMB)[:, None] * way)]
        parent += [node, *range(first, first + N_LIMB - 1)]
        radius += [thick] * N_LIMB
    return Skeleton(points, parent, radius, np.ones(len(points)))


@pytest.fixture(scope="module")
def limbed():
    skeleton = tree()
    scaffold = Scaffold(skeleton, least=0.1)
    rows = branch_rows(skeleton, scaffold.axes, 0.0)
    table = limb_rows(scaffold, rows, STEM_M, 0.0)
    traits = {
        "unit": "m",
        "limb_trunk_ratio": sum(limb.diameter**2 for limb in scaffold.limbs) / STEM_M**2,
        "limb_trunk_height_m": 0.3,
        "crown_volume_m3": 2.0,
        "crown_width_m": 1.6,
        "crown_base_height_m": min(row["height_m"] for row in table),
        "total_length_m": sum(row["length_m"] for row in rows),
        "wood_volume_m3": sum(row["volume_m3"] for row in rows),
        "n_limbs_by_diameter": {"0-0.02": 1, "0.02-": 3},
        "foot": [0.0, 0.0, 0.0],
    }
    return skeleton, traits, table


def test_the_table_is_read_as_it_was_written(limbed, tmp_path):
    path = tmp_path / "limbs.csv"
    path.write_text(branches_csv(limbed[2], LIMB_COLUMNS))
    read = read_branches(path, LIMB_COLUMNS)
    assert [row["rank"] for row in read] == [1, 2, 3, 4]
    assert read[0]["diameter_m"] == pytest.approx(0.04) and read[0]["diameter_low_m"] is None
    path.write_text("rank,branch_id\n1,no\n")
    with pytest.raises(StageError, match="table of limbs"):
        read_branches(path, LIMB_COLUMNS)


def test_a_tree_without_limbs_has_no_section(limbed):
    skeleton, traits, _ = limbed
    assert limb_section(traits, [], skeleton) is None
    assert page_template("scaffold.html.j2").render(scaffold=None).strip() == ""


def test_the_section_adds_up(limbed):
    skeleton, traits, table = limbed
    section = limb_section(traits, table, skeleton)
    assert section["classes"] == [("0 to 20 mm", 1), ("20 mm and more", 3)]
    told = json.loads(section["what_if"])
    length = told["stem"]["wood_length_m"] + sum(limb["wood_length_m"] for limb in told["limbs"])
    assert length == pytest.approx(traits["total_length_m"])
    assert told["stem"]["wood_length_m"] == pytest.approx(2.4)
    assert min(corner[2] for corner in told["stem"]["hull"]) > 0.7  # the clear stem is no crown


def without(page, name):
    return float(re.match(r"[\d.]+", page.inner_text(f"tr[data-name={name}] td:nth-child(3)"))[0])


def test_limbs_are_clicked_away_in_a_browser(limbed, browser, tmp_path):
    skeleton, traits, table = limbed
    path = tmp_path / "page.html"
    section = limb_section(traits, table, skeleton)
    body = page_template("scaffold.html.j2").render(scaffold=section)
    path.write_text(f"<!DOCTYPE html><meta charset='utf-8'>{body}", encoding="utf-8")
    page, errors = browser.new_page(), []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(path.as_uri())
    assert without(page, "ratio") == pytest.approx(traits["limb_trunk_ratio"], abs=0.005)
    assert without(page, "crown") == 2.0
    page.click("button[name=largest]")
    assert without(page, "ratio") == pytest.approx(table[0]["ratio_without"], abs=0.005)
    page.click(f"#limbs tr[data-limb='{table[2]['branch_id']}']")
    gone = {row["branch_id"] for row in (table[0], table[2])}
    assert page.locator("circle.gone").count() == 2
    left = [row for row in table if row["branch_id"] not in gone]
    ratio = sum(row["diameter_m"] ** 2 for row in left) / STEM_M**2
    assert without(page, "ratio") == pytest.approx(ratio, abs=0.005)
    volume = traits["wood_volume_m3"] - sum(table[k]["wood_volume_m3"] for k in (0, 2))
    assert without(page, "volume") == pytest.approx(1e3 * volume, abs=0.005)
    axis_list = axes(skeleton)
    base = traits["crown_base_height_m"]
    stem = axis_list[0].nodes[skeleton.points[axis_list[0].nodes, 2] >= base]
    kept = [axis.nodes for at, axis in enumerate(axis_list) if at and at not in gone]
    every = [axis.nodes for axis in axis_list[1:]]
    hulls = [ConvexHull(skeleton.points[np.concatenate([stem, *some])]) for some in (kept, every)]
    share = hulls[0].volume / hulls[1].volume
    assert without(page, "crown") == pytest.approx(2.0 * share, abs=0.011)
    page.focus("#limbs circle")
    page.keyboard.press("Enter")
    assert page.locator("circle.gone").count() == 1  # the first is back
    page.click("button[name=all]")
    assert without(page, "n") == 4
    assert errors == []
