"""Hand measurements on generated trees: the place, our number there, and how well both agree."""

import csv
import json
import math

import numpy as np
import pytest

from cherrypicker.accuracy.compare import ComparedTree
from cherrypicker.accuracy.measures import read_measures
from cherrypicker.accuracy.places import Places
from cherrypicker.batch.summary import summarise
from cherrypicker.geometry.error_terms import FACTORS
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.branches import branch_rows

HEAD = "tree,trait,value,unit,who,height_m,azimuth_deg,distance_m,x_m,y_m,z_m,order\n"
FOOT_Z, STEP, N_STEPS = 0.2, 0.02, 40
RADIUS_ERROR, SCATTER, SCALE_ERROR = 0.0004, 0.001, 0.01
LIMB_HEIGHTS = (0.5, 0.8, 1.1, 1.4)


class Orchard:
    """Trees with a straight stem and four limbs that rise and taper: all numbers are known."""

    def __init__(self, n_trees=20, seed=0):
        rng = np.random.default_rng(seed)
        self.trees = {f"tree{i:02d}": self._grow(rng) for i in range(n_trees)}

    def _grow(self, rng):
        thick = rng.uniform(0.03, 0.06)
        azimuths = np.radians(rng.uniform(0, 40) + np.array([0, 100, 190, 280]))
        bases = rng.uniform(0.009, 0.014, len(LIMB_HEIGHTS))
        stem = [(0.0, 0.0, FOOT_Z + 0.05 * i) for i in range(41)]
        points, parent = list(stem), [-1, *range(40)]
        radius = [thick - 0.0004 * i for i in range(41)]
        for height, azimuth, base in zip(LIMB_HEIGHTS, azimuths, bases, strict=True):
            way = np.array([np.cos(azimuth), np.sin(azimuth), 1.0]) / math.sqrt(2)
            for step in range(1, N_STEPS + 1):
                points.append(np.array([0, 0, FOOT_Z + height]) + step * STEP * way)
                parent.append(round(height / 0.05) if step == 1 else len(points) - 2)
                radius.append(base - 0.005 * step / N_STEPS)
        fields = {"residual": SCATTER, "radius_error": RADIUS_ERROR, "n_points": 50, "arc_deg": 300}
        fields = {name: np.full(len(points), value) for name, value in fields.items()}
        skeleton = Skeleton(points, parent, radius, [1] * 41 + [2] * (len(points) - 41), fields)
        rows = branch_rows(skeleton, axes(skeleton), FOOT_Z)
        diameter = 2 * (thick - 0.0004 * 6)
        traits = {"unit": "m", "foot": [0, 0, FOOT_Z], "trunk_height_m": 0.3, "height_m": 2.0}
        traits |= {"trunk_diameter_m": diameter, "height_m_ci90": [1.98, 2.02]}
        traits |= {"trunk_diameter_m_ci90": [diameter - 0.001, diameter + 0.001]}
        traits |= {"trunk_diameters": {"1.00": 0.05}, "trunk_diameters_se": {"1.00": 0.001}}
        return {
            "skeleton": skeleton,
            "rows": rows,
            "traits": traits,
            "azimuths": azimuths,
            "bases": bases,
        }

    def on_bark(self, tree, limb, along):
        """A point on a limb's side, so far along it, and the limb's diameter there."""
        azimuth, base = self.trees[tree]["azimuths"][limb], self.trees[tree]["bases"][limb]
        radius = base - 0.005 * along / (N_STEPS * STEP)
        way = np.array([np.cos(azimuth), np.sin(azimuth), 1.0]) / math.sqrt(2)
        aside = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        foot = np.array([0, 0, FOOT_Z + LIMB_HEIGHTS[limb]])
        return foot + along * way + radius * aside, 2 * radius

    def measured(self, tree, **changes):
        parts = {"scale": {"scale": 2.0, "scale_std": 2.0 * SCALE_ERROR}} | changes
        own = self.trees[tree]
        return ComparedTree(own["traits"], own["rows"], own["skeleton"], **parts)


@pytest.fixture(scope="module")
def orchard():
    return Orchard()


@pytest.fixture
def pair(orchard, tmp_path):
    """Our number for one row of the table, on the first tree."""

    def pair(row, tree="tree00", **files):
        path = tmp_path / "measures.csv"
        path.write_text(f"{HEAD}{tree},{row}\n")
        (measure,) = read_measures(path)
        return orchard.measured(tree, **files).pair(measure)

    return pair


def test_a_point_on_the_bark_finds_its_branch_and_the_diameter_there(orchard, pair):
    for limb, along in ((0, 0.2), (3, 0.61)):
        point, diameter = orchard.on_bark("tree00", limb, along)
        found = pair(f"branch_diameter,20,mm,,,,,{point[0]},{point[1]},{point[2]}")
        base = orchard.trees["tree00"]["rows"][found["branch_id"]]["base_height_m"]
        assert base == pytest.approx(LIMB_HEIGHTS[limb])
        assert found["ours"] == pytest.approx(diameter, abs=1e-6)
    assert pair("branch_diameter,20,mm,,,,,1,1,1")["problem"].startswith("no branch within 10 cm")


def test_height_and_azimuth_find_the_branch_that_the_level_line_meets(orchard, pair):
    azimuth = math.degrees(orchard.trees["tree00"]["azimuths"][1])
    _, diameter = orchard.on_bark("tree00", 1, 0.3 * math.sqrt(2))
    for off in (-4, 0, 4):
        found = pair(f"branch_diameter,20,mm,,{0.8 + 0.3},{azimuth + off}")
        assert found["ours"] == pytest.approx(diameter, abs=2e-4)
        assert found["doubts"] == []
    with_distance = pair(f"branch_diameter,20,mm,,{0.8 + 0.3},{azimuth},0.3")
    assert with_distance["ours"] == pytest.approx(diameter, abs=1e-6)
    angle = pair(f"branch_angle,44,deg,,{0.8 + 0.3},{azimuth}")
    assert angle["ours"] == pytest.approx(45.0, abs=0.5)
    assert angle["low"] < angle["ours"] < angle["high"]


def test_the_order_of_a_branch_keeps_its_parent_and_its_laterals_out():
    limb = [[0.05 * i, 0, 0.5] for i in range(1, 15)]
    lateral = [[0.35, 0.05 * i, 0.5] for i in range(1, 6)]
    skeleton = Skeleton(
        [[0, 0, 0.1 * i] for i in range(11)] + limb + lateral,
        [-1, *range(10), 5, *range(11, 24), 17, *range(25, 29)],
        [0.03] * 11 + [0.012] * 14 + [0.004] * 5,
        [1] * 11 + [2] * 19,
    )
    axis_list = axes(skeleton)
    places = Places(skeleton, axis_list, 0.0)
    at = {"height": 0.5, "azimuth_deg": 10.0, "distance": 0.36}
    assert axis_list[places.towards(**at).branch].order == 1
    assert axis_list[places.towards(**at, order=2).branch].order == 2
    assert places.towards(**at, order=3) is None
    inside_the_limb = np.array([0.35, 0.0, 0.5])
    assert axis_list[places.at_point(inside_the_limb).branch].order == 1
    assert axis_list[places.at_point(inside_the_limb, order=2).branch].order == 2


def test_a_level_line_between_two_limbs_is_told_as_doubtful(pair):
    skeleton = Skeleton(
        [[0, 0, 0.1 * i] for i in range(11)]
        + [[0.1 * i, side * 0.06, 0.5] for side in (-1, 1) for i in range(1, 8)],
        [-1, *range(10), 5, *range(11, 17), 5, *range(18, 24)],
        [0.03] * 11 + [0.01] * 14,
        [1] * 11 + [2] * 14,
    )
    rows = branch_rows(skeleton, axes(skeleton), 0.0)
    traits = {"unit": "m", "foot": [0, 0, 0]}
    tree = ComparedTree(traits, rows, skeleton)
    place = tree.places.towards(0.5, 1.0)
    assert {place.branch, *place.rivals} == {1, 2}


def test_a_trunk_diameter_is_taken_at_its_height(pair, orchard):
    own = orchard.trees["tree00"]
    assert pair("trunk_diameter,90,mm,,0.3")["ours"] == pytest.approx(
        own["traits"]["trunk_diameter_m"], abs=1e-6
    )
    at_one = pair("trunk_diameter,50,mm,,1.0")
    assert (at_one["ours"], at_one["low"]) == (0.05, pytest.approx(0.05 - 1.645 * 0.001))
    between = pair("trunk_diameter,90,mm,,0.7")["ours"]
    assert between == pytest.approx(2 * own["skeleton"].radius[14], abs=1e-6)
    assert pair("trunk_diameter,50,mm,,2.5")["problem"] == "the trunk ends below 2.5 m"


def test_another_unit_and_a_girth_are_told_where_they_would_fit(pair, orchard):
    diameter = 1000 * orchard.trees["tree00"]["traits"]["trunk_diameter_m"]
    assert pair(f"trunk_diameter,{diameter},mm")["doubts"] == []
    assert "would fit in mm: check the unit" in pair(f"trunk_diameter,{diameter},cm")["doubts"][0]
    assert "as a girth" in pair(f"trunk_diameter,{math.pi * diameter},mm")["doubts"][0]


def test_photos_that_saw_a_branch_tell_its_diameter_here_too(orchard, pair):
    point, diameter = orchard.on_bark("tree00", 0, 0.4)
    own = orchard.trees["tree00"]
    row = next(r for r in own["rows"] if r["base_height_m"] < 0.6 and r["order"])
    nodes = axes(own["skeleton"])[row["branch_id"]].nodes
    widths = (1.8 * own["skeleton"].radius[nodes]).tolist()
    each = {"branch_id": row["branch_id"], "diameter_se": 1e-5, "widths": widths}
    told = f"branch_diameter,20,mm,,,,,{point[0]},{point[1]},{point[2]}"
    seen, unseen = pair(told, photo_check={"branches": [each]}), pair(told)
    assert unseen["ours"] == pytest.approx(diameter, abs=1e-6)
    assert seen["ours"] == pytest.approx(0.9 * diameter, rel=0.05)
    assert seen["high"] - seen["low"] < unseen["high"] - unseen["low"]


def test_a_scan_without_a_scale_has_no_lengths_to_compare(orchard, tmp_path):
    path = tmp_path / "measures.csv"
    path.write_text(f"{HEAD}a,height,2,m\n")
    own = orchard.trees["tree00"]
    free = Skeleton(
        own["skeleton"].points,
        own["skeleton"].parent,
        own["skeleton"].radius,
        own["skeleton"].label,
        unit="arbitrary",
    )
    found = ComparedTree(own["traits"], own["rows"], free).pair(read_measures(path)[0])
    assert (found["ours"], found["problem"]) == (None, "the scan has no scale")


def test_twenty_trees_with_a_calliper_agree_as_computed_by_hand(orchard, tmp_path, monkeypatch):
    """The whole way of the table, against numpy written out here."""
    rng = np.random.default_rng(5)
    lines, truth = [], {"branch_diameter_m": [], "trunk_diameter_m": []}
    for tree, own in orchard.trees.items():
        ours = own["traits"]["trunk_diameter_m"]
        hand = round(ours + rng.normal(0.0005, 0.001), 4)
        lines.append(f"{tree},trunk_diameter,{1000 * hand:.1f},mm,AB")
        truth["trunk_diameter_m"].append((ours, hand, 0.001))
        for limb in range(4):
            point, ours = orchard.on_bark(tree, limb, rng.uniform(0.1, 0.75))
            hand = round(ours + rng.normal(-0.0003, 0.0012), 4)
            place = ",".join(map(repr, point.tolist()))
            lines.append(f"{tree},branch_diameter,{100 * hand:.2f},cm,AB,,,,{place}")
            half = 1.645 * np.sqrt(
                (2 * RADIUS_ERROR) ** 2
                + (FACTORS["diameter_shared"] * SCATTER) ** 2
                + (SCALE_ERROR * ours) ** 2
            )
            truth["branch_diameter_m"].append((ours, hand, half))
    table = tmp_path / "measures.csv"
    table.write_text(HEAD + "\n".join(lines))
    results = tmp_path / "results"
    measures = read_measures(table)
    for tree, own in orchard.trees.items():
        measured = orchard.measured(tree)
        pairs = [measured.pair(measure) for measure in measures if measure.tree == tree]
        (results / tree).mkdir(parents=True)
        (results / tree / "traits.json").write_text(json.dumps(own["traits"]))
        (results / tree / "measures.json").write_text(json.dumps({"measures": pairs}))
    monkeypatch.chdir(tmp_path)
    trees = [{"tree": tree} for tree in orchard.trees]
    summarise(trees, results / "traits.csv", results / "summary.html")
    with open(results / "accuracy.csv", newline="", encoding="utf-8") as stream:
        rows = [row for row in csv.DictReader(stream) if row["source"] == "this batch"]
    assert [row["trait"] for row in rows] == ["trunk_diameter_m", "branch_diameter_m"]
    for row in rows:
        ours, hand, half = np.array(truth[row["trait"]]).T
        error = ours - hand
        squares = np.sum((hand - np.mean(hand)) ** 2)
        expected = {
            "n": len(hand),
            "mae": np.mean(np.abs(error)),
            "rmse": np.sqrt(np.mean(error**2)),
            "relative_rmse": np.sqrt(np.mean(error**2)) / np.mean(hand),
            "r2": 1 - np.sum(error**2) / squares,
            "bias": np.mean(error),
            "low": np.mean(error) - 1.96 * np.std(error, ddof=1),
            "high": np.mean(error) + 1.96 * np.std(error, ddof=1),
            "n_intervals": len(hand),
            "n_covered": np.sum(np.abs(error) <= half),
        }
        for name, value in expected.items():
            assert float(row[name]) == pytest.approx(value, rel=1e-4, abs=1e-6), (
                row["trait"],
                name,
            )
    page = (results / "summary.html").read_text()
    assert page.count("<circle") == 20 + 80
    assert "AppleQSM" in page
