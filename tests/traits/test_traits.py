"""Traits of synthetic trees whose answers are known."""

import csv
import io
import re
from dataclasses import replace

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.geometry.neighbors import quick_tree
from cherrypicker.geometry.sections import fit_section
from cherrypicker.geometry.stem_slabs import search_circle
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.branches import branch_rows, branches_csv
from cherrypicker.traits.foot import find_foot
from cherrypicker.traits.measure import TraitOptions, measure_traits
from cherrypicker.traits.reports import Reports
from cherrypicker.traits.support import find_support, support_reach
from cherrypicker.traits.table import BRANCH_COLUMNS, LIMB_COLUMNS, TRAITS


def surface(start, end, r_start, r_end, n, rng, noise=0.0, arc=(0.0, 2 * np.pi)):
    """Points on a cone's surface between two points, with radial noise."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = (end - start) / np.linalg.norm(end - start)
    u = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    t, angle = rng.random(n), rng.uniform(*arc, n)
    radius = r_start + t * (r_end - r_start) + noise * rng.standard_normal(n)
    across = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
    return start + t[:, None] * (end - start) + radius[:, None] * across


def line_nodes(start, end, step=0.02):
    n = max(int(round(np.linalg.norm(np.subtract(end, start)) / step)), 1)
    return np.linspace(start, end, n + 1)


class Tree:
    """A stem along z with straight branches: skeleton, cloud and truth."""

    def __init__(self, lean=0.0, radius=0.05, top_radius=0.04, height=2.0, noise=0.0, seed=0):
        self.rng = np.random.default_rng(seed)
        self.foot = np.array([0.3, -0.2, 0.0])
        self.direction = np.array([np.sin(np.radians(lean)), 0.0, np.cos(np.radians(lean))])
        self.radius, self.top_radius, self.height, self.noise = radius, top_radius, height, noise
        stem = self.foot + line_nodes([0, 0, 0], [0, 0, height])[:, 2:] * self.direction
        share = np.linspace(0, 1, len(stem))
        self.points, self.parent = [*stem], [-1, *range(len(stem) - 1)]
        self.radii = [*(radius + share * (top_radius - radius))]
        self.stem = stem
        self.cloud, self.labels = [], []
        self.add_points(
            surface(stem[0], stem[-1], radius, top_radius, 20_000, self.rng, noise), Label.TRUNK
        )

    def add_points(self, points, label):
        self.cloud.append(points)
        self.labels.append(np.full(len(points), int(label), np.uint8))

    def add_branch(self, at, angle_deg, azimuth_deg, length, radius=0.012):
        node = int(np.argmin(np.abs(np.linspace(0, self.height, len(self.stem)) - at)))
        angle, azimuth = np.radians(angle_deg), np.radians(azimuth_deg)
        direction = [
            np.sin(angle) * np.cos(azimuth),
            np.sin(angle) * np.sin(azimuth),
            np.cos(angle),
        ]
        nodes = line_nodes([0, 0, 0], np.multiply(length, direction)) + self.stem[node]
        first = len(self.points)
        self.points += [*nodes[1:]]
        self.parent += [node, *range(first, first + len(nodes) - 2)]
        self.radii += [radius] * (len(nodes) - 1)
        self.add_points(
            surface(nodes[0], nodes[-1], radius, radius, 8000, self.rng, self.noise), Label.BRANCH
        )

    def add_ground(self, slope=0.0):
        xy = self.rng.uniform(-1.5, 1.5, (10_000, 2)) + self.foot[:2]
        z = slope * (xy[:, 0] - self.foot[0]) + 0.005 * self.rng.standard_normal(len(xy))
        away = np.hypot(*(xy - self.foot[:2]).T) > self.radius
        self.add_points(np.column_stack([xy, z])[away], Label.GROUND)

    def skeleton(self):
        n = len(self.points)
        fields = {"residual": np.full(n, 0.001), "radius_error": np.full(n, 2e-4)}
        return Skeleton(self.points, self.parent, self.radii, np.full(n, 1), fields)

    def scan(self, unit="m"):
        labels = np.concatenate(self.labels)
        fields = {"label": labels, "confidence": np.full(len(labels), 0.9, np.float32)}
        return PointCloud(np.vstack(self.cloud), fields=fields, frame="metric", unit=unit)

    def diameter_at(self, height):
        share = height / (self.height * self.direction[2])
        return 2 * (self.radius + share * (self.top_radius - self.radius))


@pytest.fixture(scope="module")
def y_tree():
    tree = Tree(noise=0.002)
    tree.add_ground()
    tree.add_branch(1.0, 45, 90, 0.8)
    tree.add_branch(1.4, 60, 210, 0.6)
    return tree


@pytest.fixture(scope="module")
def y_traits(y_tree):
    skeleton = y_tree.skeleton()
    options = TraitOptions(row_distance_m=4.0)
    return measure_traits(skeleton, y_tree.scan(), options=options)


def test_plain_tree(y_tree, y_traits):
    traits, tables = y_traits
    assert traits["unit"] == "m"
    assert traits["height_m"] == pytest.approx(2.0, abs=0.01)
    assert traits["trunk_height_m"] == 0.30
    assert traits["trunk_diameter_m"] == pytest.approx(y_tree.diameter_at(0.30), abs=0.001)
    assert traits["tcsa_cm2"] == pytest.approx(
        np.pi / 4 * (100 * traits["trunk_diameter_m"]) ** 2, rel=1e-3
    )
    assert traits["total_length_m"] == pytest.approx(2.0 + 0.8 + 0.6, abs=1e-6)
    assert (traits["n_junctions"], traits["n_tips"]) == (2, 3)
    assert traits["n_branches_by_order"] == {"0": 1, "1": 2}
    assert traits["length_by_order_m"]["1"] == pytest.approx(1.4, abs=1e-6)
    assert traits["mean_diameter_by_order_m"]["1"] == pytest.approx(0.024)
    assert traits["trunk_diameters"]["1.00"] == pytest.approx(y_tree.diameter_at(1.0), abs=0.002)
    lengths = [row["length_m"] for row in tables["branches"]]
    assert sum(lengths) == pytest.approx(traits["total_length_m"], abs=1e-5)
    assert traits["flags"] == []


def test_numbers_and_sums_hold_the_truth_between_their_ends(y_traits):
    traits, _ = y_traits
    for name, true in (("total_length_m", 3.4), ("n_shoots", 2), ("n_tips", 3)):
        low, high = traits[f"{name}_ci90"]
        assert low <= true <= high, name
        assert high - low < 0.3 * true, name
    low, high = traits["wood_volume_m3_ci90"]
    assert low < traits["wood_volume_m3"] < high
    assert traits["length_by_order_m_ci90"]["1"][0] < 1.4 < traits["length_by_order_m_ci90"]["1"][1]
    assert isinstance(traits["n_tips"], int)


def test_a_trunk_that_photos_doubt_is_there(y_tree, y_traits):
    axes = [{"branch_id": 0, "p_exists": 0.5}]
    reports = Reports(photo_check={"axes": axes})
    found, _ = measure_traits(y_tree.skeleton(), y_tree.scan(), reports)
    assert found["total_length_m_ci90"] == y_traits[0]["total_length_m_ci90"]


def test_heights_are_over_the_foot_wherever_the_cloud_lies(y_tree, y_traits):
    skeleton, scan, up = y_tree.skeleton(), y_tree.scan(), np.array([0.0, 0.0, 3.0])
    moved = replace(skeleton, points=skeleton.points + up), replace(scan, points=scan.points + up)
    traits, tables = measure_traits(*moved)
    for name in ("height_m", "trunk_height_m", "trunk_diameters", "crown_base_height_m"):
        assert traits[name] == pytest.approx(y_traits[0][name], abs=0.005), name
    heights = [[row["base_height_m"] for row in each["branches"]] for each in (tables, y_traits[1])]
    assert heights[0] == pytest.approx(heights[1], abs=0.005)


def test_the_volume_of_a_row_is_that_of_a_hectare(y_traits):
    traits, _ = y_traits
    expected = traits["height_m"] * traits["crown_width_m"] * 10_000 / 4.0
    assert traits["tree_row_volume_m3_ha"] == pytest.approx(expected, rel=1e-3)


def test_intervals_hold_the_estimate(y_traits):
    traits, _ = y_traits
    for name in (name for name, trait in TRAITS.items() if trait.has_error):
        low, high = traits[f"{name}_ci90"]
        assert low <= traits[name] <= high
        power = TRAITS[name].power or 2  # the ratio is one of squares
        assert 0 < traits[f"{name}_se"] < 0.1 * power * traits[name]


def test_every_trait_is_a_row_of_the_table(y_traits):
    traits, _ = y_traits
    numbers = {name for name, value in traits.items() if isinstance(value, int | float)}
    errors = {name for name in numbers if name.endswith("_se")}
    by_photos = {name for name in TRAITS if "photo" in name}  # this tree has none
    assert numbers - errors == TRAITS.keys() - by_photos
    assert errors == {f"{name}_se" for name, trait in TRAITS.items() if trait.has_error}


def test_the_docs_list_every_object_and_column(y_traits, project):
    """The numbers stand in docs/trait_list.md, which is written from their table."""
    page = (project / "docs/traits.md").read_text(encoding="utf-8")
    _, whole, branches, limbs, *_ = re.split(r"^## ", page, flags=re.M)
    rows = [line.split("|")[1] for line in whole.splitlines() if line.startswith("| `")]
    told = {name for row in rows for name in re.findall("`(.*?)`", row)}
    objects = {name for name, value in y_traits[0].items() if isinstance(value, dict)}
    assert told == objects | {"at_least", "flags"}
    for section, columns in ((branches, BRANCH_COLUMNS), (limbs, LIMB_COLUMNS)):
        cells = "".join(re.findall(r"^\| (`.*?) \|", section, re.M))
        assert re.findall("`([a-z0-9_]+)`", cells) == list(columns)


def test_branch_angles(y_tree):
    skeleton = y_tree.skeleton()
    rows = branch_rows(skeleton, axes(skeleton), 0.0)
    first = next(row for row in rows if abs(row["length_m"] - 0.8) < 1e-6)
    assert first["insertion_angle_deg"] == pytest.approx(45, abs=0.5)
    assert first["azimuth_deg"] == pytest.approx(90, abs=0.5)
    assert first["base_height_m"] == pytest.approx(1.0, abs=0.011)
    assert first["chord_m"] == pytest.approx(0.8, abs=1e-6)
    assert first["base_diameter_m"] == pytest.approx(0.024)
    assert (first["parent_id"], first["order"]) == (0, 1)
    table = list(csv.DictReader(io.StringIO(branches_csv(rows))))
    assert list(table[0]) == list(BRANCH_COLUMNS)
    assert table[0]["parent_id"] == "-1"


def test_crown_of_four_branches():
    tree = Tree(height=1.5)
    for azimuth in (0, 90, 180, 270):
        tree.add_branch(1.0, 90, azimuth, 0.7, radius=0.005)
    traits, _ = measure_traits(tree.skeleton(), tree.scan())
    # A horizontal square with diagonals of 1.4 m, its widest extent a diagonal
    assert traits["crown_width_m"] == pytest.approx(1.4, rel=0.03)
    # with the trunk's top 0.5 m above: a pyramid on that square
    assert traits["crown_volume_m3"] == pytest.approx(1.4**2 / 2 * 0.5 / 3, rel=0.25)


@pytest.mark.parametrize("lean", [0, 20])
def test_ring_post_and_noise_do_not_fool_the_trunk(lean):
    tree = Tree(lean=lean, noise=0.003)
    at = 0.30 / tree.direction[2]
    ring = tree.foot + np.array([[at - 0.02], [at + 0.02]]) * tree.direction
    # A calibration ring, a third of it with the wrong label, hides the bark
    for points, labels in zip(tree.cloud, tree.labels, strict=True):
        along = (points - tree.foot) @ tree.direction
        keep = np.abs(along - at) > 0.02
        tree.cloud, tree.labels = [points[keep]], [labels[keep]]
    ring_points = surface(*ring, 0.058, 0.058, 3000, tree.rng, 0.001)
    tree.add_points(ring_points[:2000], Label.CALIBRATION_UNIT)
    tree.add_points(ring_points[2000:], Label.TRUNK)
    # and a post that the network took for trunk stands beside it
    post = tree.foot + [0.09, 0.02, 0.0]
    tree.add_points(surface(post, post + [0, 0, 1.5], 0.02, 0.02, 8000, tree.rng), Label.TRUNK)
    tree.add_ground()
    traits, _ = measure_traits(tree.skeleton(), tree.scan())
    assert traits["trunk_diameter_m"] == pytest.approx(tree.diameter_at(0.30), abs=0.003)


def test_a_stem_hidden_at_the_height_is_measured_where_it_is_seen():
    tree = Tree(noise=0.001)
    points = tree.cloud[0]
    seen = np.abs(points[:, 2] - 0.33) > 0.11  # the slab holds points of its lowest 2 cm
    tree.cloud, tree.labels = [points[seen]], [tree.labels[0][seen]]
    tree.add_ground()
    traits, _ = measure_traits(tree.skeleton(), tree.scan())
    assert any(flag.startswith("trunk_height_moved") for flag in traits["flags"])
    height = traits["trunk_height_m"]
    assert height < 0.22 or height > 0.44
    assert traits["trunk_diameter_m"] == pytest.approx(tree.diameter_at(height), abs=0.001)


def test_half_a_trunk_is_flagged():
    tree = Tree(noise=0.002)
    kept = (tree.cloud[0] - tree.foot) @ [1.0, 0.0, 0.0] > 0.01
    tree.cloud, tree.labels = [tree.cloud[0][kept]], [tree.labels[0][kept]]
    traits, _ = measure_traits(tree.skeleton(), tree.scan())
    assert traits["trunk_diameter_m"] == pytest.approx(tree.diameter_at(0.30), abs=0.006)
    assert any(flag.startswith("arc_coverage_low") for flag in traits["flags"])


def test_floaters_do_not_raise_the_tree(y_tree):
    tree = Tree()
    rng = np.random.default_rng(3)
    tree.add_points(tree.stem[-1] + [0, 0, 0.5] + 0.01 * rng.standard_normal((40, 3)), Label.BRANCH)
    # Even where the skeleton went there
    top = len(tree.points) - 1
    tree.points += [tree.stem[-1] + [0, 0, 0.48], tree.stem[-1] + [0, 0, 0.51]]
    tree.parent += [top, top + 1]
    tree.radii += [0.01, 0.01]
    tree.add_ground()
    traits, _ = measure_traits(tree.skeleton(), tree.scan())
    assert traits["height_m"] == pytest.approx(2.0, abs=0.02)
    assert any(flag.startswith("stray_pieces") for flag in traits["flags"])
    assert any(flag.startswith("gaps_bridged") for flag in traits["flags"])
    # but what they are nobody knows
    assert "height_m" in traits["at_least"] and traits["height_m_ci90"][1] > 2.48


@pytest.mark.parametrize("gap, height", [(0.2, 2.0), (0.5, 1.3)])
def test_wood_longer_than_the_gap_below_it_belongs_to_the_tree(gap, height):
    tree = Tree()
    away = np.abs(tree.cloud[0][:, 2] - 1.3 - gap / 2) > gap / 2
    shorter = tree.cloud[0][:, 2] < (2.0 if height == 2.0 else 1.3 + gap + 0.1)
    tree.cloud, tree.labels = [tree.cloud[0][away & shorter]], [tree.labels[0][away & shorter]]
    tree.add_ground()
    traits, _ = measure_traits(tree.skeleton(), tree.scan())
    assert traits["height_m"] == pytest.approx(height, abs=0.02)
    assert ("height_m" in traits["at_least"]) == (height < 2.0)


def test_gap_in_the_stem_is_reported_not_cut():
    tree = Tree()
    away = np.abs((tree.cloud[0] - tree.foot)[:, 2] - 0.8) > 0.1
    tree.cloud, tree.labels = [tree.cloud[0][away]], [tree.labels[0][away]]
    wood = quick_tree(np.vstack(tree.cloud))
    support = find_support(tree.skeleton(), wood, 0.03, max_gap=0.05)
    assert len(support.gaps) == 1
    assert 0.05 < support.gaps[0] < 0.21
    assert support.node.all()


def test_foot_on_a_slope():
    tree = Tree()
    tree.add_ground(slope=0.2)
    skeleton = tree.skeleton()
    skeleton.points[0, 2] += 0.08  # a root that does not reach the ground
    scan = tree.scan()
    foot = find_foot(skeleton, axes(skeleton)[0].nodes, scan.points, scan["label"])
    assert foot.source == "ground"
    assert foot.point[2] == pytest.approx(0.0, abs=0.005)


def test_short_trunk_measures_where_it_can():
    tree = Tree(height=0.25)
    tree.add_branch(0.24, 30, 0, 0.8, radius=0.02)
    tree.add_branch(0.24, 30, 180, 0.8, radius=0.02)
    traits, _ = measure_traits(tree.skeleton(), tree.scan())
    assert 0.05 <= traits["trunk_height_m"] < 0.30
    assert traits["trunk_diameter_m"] == pytest.approx(0.09, abs=0.01)
    assert any(flag.startswith("trunk_height_moved") for flag in traits["flags"])


def test_unscaled_results_do_not_say_metres(y_tree):
    traits, _ = measure_traits(y_tree.skeleton(), y_tree.scan(unit="arbitrary"))
    assert traits["unit"] == "arbitrary"
    assert traits["flags"][0].startswith("unscaled")
    assert not any(f" {word}" in flag for flag in traits["flags"] for word in ("m ", "m,", "metre"))


def test_scale_error_widens_intervals(y_tree):
    skeleton, scan = y_tree.skeleton(), y_tree.scan()
    loose = {"scale": 2.0, "scale_std": 0.04, "unit": "m"}
    plain, _ = measure_traits(skeleton, scan)
    wide, _ = measure_traits(skeleton, scan, reports=Reports(scale=loose))
    assert wide["height_m_se"] == pytest.approx(0.02 * wide["height_m"], rel=0.3)
    assert wide["trunk_diameter_m_se"] > plain["trunk_diameter_m_se"]
    assert any(flag.startswith("scale_uncertain") for flag in wide["flags"])
    for name, power in (("height_m", 1), ("crown_volume_m3", 3)):
        share = wide["interval_terms"][name]["scale"] / wide[name]
        assert share == pytest.approx(0.02 * power, rel=0.02), name


def test_unsure_cameras_are_flagged(y_tree):
    skeleton, scan = y_tree.skeleton(), y_tree.scan()
    for doubt in ("", "known within 1.2 px, held by only 40 matches (median 900)"):
        sure = {"median": 0.4, "max": 1.2, "worst": "IMG_7.jpg"}
        photos = {"IMG_6.jpg": {"doubt": ""}, "IMG_7.jpg": {"doubt": doubt}}
        sparse = {"n_photos": 9, "n_registered": 7, "n_left_out": 2, "photos": photos}
        sparse["camera_error_px"] = sure
        traits, _ = measure_traits(skeleton, scan, reports=Reports(sparse=sparse))
        flags = {flag.split(":")[0]: flag for flag in traits["flags"]}
        assert ("cameras_uncertain" in flags) is bool(doubt)
        assert "7 of 9 photos are used, 2 were left out" in flags["few_photos"]
        if doubt:
            assert "1 of 7" in flags["cameras_uncertain"]
            assert "IMG_7.jpg is known within 1.2 px" in flags["cameras_uncertain"]


def test_same_seed_same_traits(y_tree, y_traits):
    skeleton = y_tree.skeleton()
    options = TraitOptions(row_distance_m=4.0)
    again = measure_traits(skeleton, y_tree.scan(), options=options)
    assert again == y_traits


def test_bad_input_is_the_users_error(y_tree):
    lonely = Skeleton([[0, 0, 0]], [-1], [0.1], [1])
    with pytest.raises(StageError, match="no edge"):
        measure_traits(lonely, y_tree.scan())
    scan = y_tree.scan()
    scan.fields["label"][:] = Label.GROUND
    with pytest.raises(StageError, match="trunk or branch"):
        measure_traits(y_tree.skeleton(), scan)


def test_circle_beside_a_bigger_one():
    rng = np.random.default_rng(0)
    stem = surface([0, 0, -0.1], [0, 0, 0.1], 0.05, 0.05, 1500, rng, 0.002)
    post = surface([0.075, 0, -0.1], [0.075, 0, 0.1], 0.02, 0.02, 500, rng, 0.002)
    both = np.vstack([stem, post])
    circle = search_circle(both[:, :2], 0.006, (0.015, 0.13), rng)
    fit = fit_section(both, circle)
    assert fit.radius == pytest.approx(0.05, abs=0.001)
    assert fit.arc_deg >= 300


def test_a_vase_whose_trunk_ends_below_a_height_is_no_warning():
    tree = Tree(height=0.8)
    tree.add_branch(0.78, 40, 0, 0.8, radius=0.02)
    tree.add_branch(0.78, 40, 180, 0.8, radius=0.02)
    tree.add_ground()
    traits, _ = measure_traits(tree.skeleton(), tree.scan())
    assert sorted(traits["trunk_diameters"]) == ["0.50"]
    assert traits["trunk_end_height_m"] < 1.0
    assert traits["flags"] == []


def test_a_root_that_nothing_surrounds():
    tree = Tree()
    scan = tree.scan()
    scan = scan.select(scan.points[:, 2] > 1.2)
    traits, _ = measure_traits(tree.skeleton(), scan)
    names = [flag.split(":")[0] for flag in traits["flags"]]
    assert "foot_unseen" in names
    assert "trunk_not_measured" in names
    assert traits["trunk_diameter_m"] == pytest.approx(0.097, abs=0.005)
    assert "height_m" in traits["at_least"]  # nothing is known of what lies below the wood


def test_points_of_a_sparse_tall_scan_keep_one_another_company():
    rng = np.random.default_rng(0)
    angle, height = rng.uniform(0, 2 * np.pi, 2000), rng.uniform(0, 20, 2000)
    sparse = np.column_stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), height])
    assert 0.1 < support_reach(quick_tree(sparse)) < 0.4
    assert support_reach(quick_tree(0.01 * sparse)) == 0.03
