"""Which tree is the target, on labelled clouds whose target is known."""

import numpy as np
import pytest
from skeleton_shapes import labelled_cloud, tube
from sound_tree import flags_of
from stage_run import run_stage
from wood_choice import choose_wood

from cherrypicker.classes import Label
from cherrypicker.contraction.contract_wood import contract_wood
from cherrypicker.errors import StageError
from cherrypicker.files import read_json, write_json
from cherrypicker.geometry.sampling import voxel_thin
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import write_cloud
from cherrypicker.traits.reports import Reports
from cherrypicker.wood.target import CLOSE_CALL, TREE_SHARE, choose_target, target_report

DENSITY = 20_000  # points a square metre, 7 mm apart
REGION = Footprint(np.zeros(2), 3.0)  # cameras 3 m from the middle of the crown


def crown(rng, start, length=0.8, n=14, radius=0.01):
    """Branches from a stem's upper end, in all directions."""
    pieces = []
    for index in range(n):
        azimuth = 2 * np.pi * (index + 0.5 * rng.random()) / n
        way = np.array([np.cos(azimuth), np.sin(azimuth), 0.3 + rng.random()])
        foot = np.asarray(start, float) - [0, 0, 0.25 * rng.random()]
        end = foot + length * way / np.linalg.norm(way)
        pieces.append(tube(foot, end, radius, DENSITY, rng=rng, end_radius=0.004))
    return np.vstack(pieces)


def tree(rng, foot=(0.0, 0.0, 0.0), top=(0.0, 0.0, 1.5), **options):
    """A stem of 4 cm radius from `foot` to `top` (from the foot) with a crown."""
    foot, top = np.asarray(foot, float), np.asarray(foot, float) + top
    stem = tube(foot, top, 0.04, DENSITY, rng=rng, end_radius=0.03)
    branches = crown(rng, top, **options)
    labels = np.r_[np.full(len(stem), Label.TRUNK), np.full(len(branches), Label.BRANCH)]
    return np.vstack([stem, branches]), labels


def post(rng, xy, height=1.5, radius=0.02):
    """A post that the network took for a trunk."""
    points = tube((*xy, 0.0), (*xy, height), radius, DENSITY, rng=rng)
    return points, np.full(len(points), Label.TRUNK)


def soil(rng):
    xy = rng.uniform(-3, 3, (8000, 2))
    return np.column_stack([xy, rng.normal(0, 0.005, len(xy))]), np.full(8000, Label.GROUND)


def select(*parts, **options):
    """The target of a scene of (points, labels), and the part of each of its wood points."""
    part = np.concatenate([np.full(len(points), k) for k, (points, _) in enumerate(parts)])
    points, labels = (np.concatenate(column) for column in zip(*parts))
    _, source, _ = voxel_thin(points, 0.008)
    points, labels, part = points[source], labels[source], part[source]
    wood = np.isin(labels, (Label.TRUNK, Label.BRANCH))
    options = {"region": REGION, "ground": points[labels == Label.GROUND], **options}
    return choose_wood(points[wood], labels[wood], **options), part[wood]


def assert_is_the_first(chosen, part, others=(1,)):
    assert chosen.keep[part == 0].mean() > 0.97
    for other in others:
        assert chosen.keep[part == other].mean() < 0.05


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.mark.parametrize("height", [1.0, 1.5, 2.2])
def test_a_post_nearer_to_the_middle_than_the_stem(rng, height):
    parts = [tree(rng, (0.9, 0.5, 0.0)), post(rng, (0.05, 0.0), height), soil(rng)]
    wood, part = select(*parts)
    assert_is_the_first(wood, part)
    np.testing.assert_allclose(wood.choice.target.base[:2], [0.9, 0.5], atol=0.03)
    np.testing.assert_allclose(wood.choice.runner_up.base[:2], [0.05, 0.0], atol=0.03)
    if height < 2.0:  # as high as the tree, where the cameras look: the tree, but a close call
        assert wood.choice.margin > CLOSE_CALL
    share = wood.choice.runner_up.mass / wood.choice.target.mass
    if height == 1.0:  # the claim of wood/target.py
        assert share == pytest.approx(0.13, abs=0.01)
        assert share < TREE_SHARE and not wood.choice.other_trees


def test_a_stem_that_leans_by_25_degrees(rng):
    """Its foot stands 0.7 m off the middle of its crown, a post 0.4 m."""
    lean = np.array([np.sin(np.radians(25)), 0.0, np.cos(np.radians(25))])
    leaning = tree(rng, -0.7 * lean * [1, 1, 0] / lean[0], 1.5 * lean)
    wood, part = select(leaning, post(rng, (0.0, 0.4)), soil(rng))
    assert_is_the_first(wood, part)
    np.testing.assert_allclose(wood.choice.target.base[:2], [-0.7, 0], atol=0.05)
    assert wood.choice.target.distance == pytest.approx(0.7, abs=0.05)
    assert wood.choice.margin > 0.7


def test_a_vase_that_forks_at_30_cm(rng):
    limbs = [tube((0, 0, 0), (0, 0, 0.3), 0.05, DENSITY, rng=rng)]
    labels = [np.full(len(limbs[0]), Label.TRUNK)]
    for azimuth in np.radians([20, 140, 260]):
        end = np.array([0.7 * np.cos(azimuth), 0.7 * np.sin(azimuth), 1.4])
        limbs.append(tube((0, 0, 0.28), end, 0.03, DENSITY, rng=rng, end_radius=0.02))
        limbs.append(crown(rng, end, 0.5, 8))
    labels.append(np.full(sum(map(len, limbs[1:])), Label.BRANCH))
    vase = np.vstack(limbs), np.concatenate(labels)
    wood, part = select(vase, post(rng, (0.6, -0.4)), soil(rng))
    assert_is_the_first(wood, part)
    np.testing.assert_allclose(wood.choice.target.base[:2], 0, atol=0.05)


def test_two_trees_of_equal_size_are_a_close_call(rng):
    left, right = tree(rng, (-0.9, 0, 0)), tree(np.random.default_rng(0), (0.9, 0, 0))
    wood, part = select(left, right, soil(rng))
    assert wood.choice.margin < CLOSE_CALL
    assert len(wood.choice.other_trees) == 1
    report = target_report(wood.choice, region=REGION, factor=2.0)
    target, other = report["candidates"]
    assert target["is_target"] and not other["is_target"]
    assert report["target_xy"] == target["base"][:2]
    assert report["runner_up"] == other and report["margin"] == wood.choice.margin
    assert report["other_stems_xy"] == [other["base"][:2]]
    assert other["crop_target_xy"] == pytest.approx(np.array(other["base"][:2]) / 2, abs=1e-4)
    flags = flags_of(Reports(target=report))
    assert [flag.split(":")[0] for flag in flags] == ["target_close", "second_tree"]
    assert f"crop.target_xy: {other['crop_target_xy']}" in flags[0]
    # what the flag proposes takes the other one
    asked = 2.0 * np.array(other["crop_target_xy"])
    again, _ = select(left, right, soil(rng), target_xy=asked)
    assert again.choice.source == "config" and again.choice.margin is None
    np.testing.assert_allclose(again.choice.target.base[:2], asked, atol=0.01)
    assert not target_report(again.choice, region=REGION)["warnings"]


def test_of_two_equal_trees_the_nearer_one_without_a_doubt_at_half_a_row(rng):
    near, far = tree(rng, (0.1, 0, 0)), tree(np.random.default_rng(0), (-1.6, 0, 0))
    wood, part = select(far, near, soil(rng))
    assert_is_the_first(wood, 1 - part)
    assert wood.choice.margin > CLOSE_CALL
    assert not target_report(wood.choice, region=REGION)["warnings"]


def test_a_stake_tied_to_the_stem(rng):
    """12 cm beside the stem, called trunk, with ties: never the target itself."""
    stake = post(rng, (0.12, 0.0), 1.2)
    ties = np.vstack([tube((0, 0, z), (0.12, 0, z), 0.006, DENSITY, rng=rng) for z in (0.5, 1.0)])
    tied = tree(rng), stake, (ties, np.full(len(ties), Label.BRANCH)), soil(rng)
    wood, part = select(*tied)
    assert wood.keep[part == 0].mean() > 0.97
    np.testing.assert_allclose(wood.choice.target.base[:2], 0, atol=0.13)
    assert not wood.choice.other_trees


def test_a_stake_40_cm_off_that_is_tied_to_the_stem(rng):
    stake = post(rng, (0.4, 0.0), 1.2)
    tie = tube((0.4, 0, 1.1), (0, 0, 1.1), 0.006, DENSITY, rng=rng)
    wood, part = select(tree(rng), stake, (tie, np.full(len(tie), Label.BRANCH)), soil(rng))
    assert wood.keep[part == 0].mean() > 0.97
    assert wood.keep[part == 1].mean() < 0.2
    np.testing.assert_allclose(wood.choice.target.base[:2], 0, atol=0.03)


@pytest.mark.parametrize("stem_label", [Label.TRUNK, Label.BRANCH])
def test_a_stem_hidden_to_40_cm_by_grass(rng, stem_label):
    """Beside it a post that is seen to its foot, the only clear stem of the scene."""
    points, labels = tree(rng, (0.3, 0.0, 0.0))
    labels[labels == Label.TRUNK] = stem_label
    seen = points[:, 2] > 0.4
    around = rng.uniform(-0.6, 0.6, (4000, 2)) + [0.3, 0.0]
    grass = np.column_stack([around, 0.4 * rng.random(4000)])
    hidden = points[seen], labels[seen]
    grown = grass, np.full(len(grass), Label.GROUND)
    wood, part = select(hidden, post(rng, (-0.5, 0.3), 1.3), soil(rng), grown)
    assert_is_the_first(wood, part)
    np.testing.assert_allclose(wood.choice.target.base[:2], [0.3, 0], atol=0.04)
    assert wood.choice.margin > 0.7


def test_the_young_tree_that_is_looked_at_beside_an_old_one(rng):
    young = tree(rng, top=(0, 0, 0.7), length=0.35, n=6, radius=0.006)
    old = tree(rng, (1.0, 0.2, 0.0), top=(0, 0, 1.4), length=0.6)
    # a small tree is photographed from nearby
    wood, part = select(young, old, soil(rng), region=Footprint(np.zeros(2), 1.4))
    assert_is_the_first(wood, part)


def test_density_does_not_matter():
    """The same two stems, one of ten times the points."""
    rng = np.random.default_rng(1)
    dense = tube((0, 0, 0), (0, 0, 1.5), 0.03, 10 * DENSITY, rng=rng)
    sparse = tube((1, 0, 0), (1, 0, 1.6), 0.03, DENSITY, rng=rng)
    points = np.vstack([dense, sparse])
    owner = np.r_[np.zeros(len(dense), int), np.ones(len(sparse), int)]
    choice = choose_target(points, [np.zeros(3), np.array([1.0, 0, 0])], owner)
    assert choice.target.stem == 1 and choice.target.distance is None
    assert choice.target.mass / choice.runner_up.mass == pytest.approx(1.07, abs=0.1)


def test_a_ready_cloud_gets_the_same_decision(rng):
    """No cameras: the mass and the height alone."""
    parts = tree(rng, (5.0, 5.0, 2.0)), tree(rng, (7.5, 5.0, 2.0), (0, 0, 1.0), length=0.5)
    points, labels = (np.concatenate(column) for column in zip(*parts))
    _, details = contract_wood(labelled_cloud(points, labels))
    report = target_report(details["choice"])
    assert report["target_xy"] == pytest.approx([5, 5], abs=0.03)
    assert report["region"] is None and report["source"] == "wood" and report["factor"] == 1.0
    assert len(report["other_stems_xy"]) == 1
    assert details["base"][:2] == pytest.approx([5, 5], abs=0.03)


def test_the_config_names_a_place_of_the_scene(rng):
    parts = tree(rng), soil(rng)
    for wrong in ((4.0, 0.0), (np.nan, 0.0)):
        with pytest.raises(StageError) as caught:
            select(*parts, target_xy=wrong)
        assert caught.value.key == "crop.target_xy"
    with pytest.raises(StageError, match="outside the wood"):
        select(*parts, target_xy=(4.0, 0.0), region=None)
    wood, _ = select(*parts, target_xy=(1.5, 0.0))
    (warning,) = target_report(wood.choice)["warnings"]
    assert warning.startswith("target_far: ") and "1.5" in warning


def test_who_points_at_a_tree_does_not_mean_the_splinter_beside_its_foot():
    """Of a sparse cloud's foot a few points may stand alone, nearer to the place that was given."""
    foot = np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, 2.0], 50)
    points = np.vstack([foot, [[0.03, 0.0, 0.0], [0.03, 0.0, 0.03]]])
    owner, options = np.r_[np.zeros(50, int), 1, 1], {"spacing": 0.02}
    bases = [points[0], points[-2]]
    choice = choose_target(points, bases, owner, target_xy=(0.02, 0.0), **options)
    assert choice.target.stem == 0 and choice.off == pytest.approx(0.02)


def test_who_points_at_a_young_tree_does_not_mean_its_high_neighbour():
    young, old = (np.linspace([x, 0, 0], [x, 0, height], 200) for x, height in ((0, 0.8), (1, 4.0)))
    points, owner = np.vstack([young, old]), np.repeat([0, 1], 200)
    choice = choose_target(points, [young[0], old[0]], owner, target_xy=(0.25, 0.0))
    assert choice.target.stem == 0 and choice.candidates[0].stem == 1


def test_the_stage_takes_crop_target_xy_in_the_aligned_frame(rng, tmp_path):
    """Half a metre a unit: the tree at x = 0.9 m stands at 1.8 there."""
    parts = tree(rng, (-0.3, 0, 0)), tree(np.random.default_rng(0), (0.9, 0, 0)), soil(rng)
    points, labels = (np.concatenate(column) for column in zip(*parts))
    write_cloud(tmp_path / "segmented.ply", labelled_cloud(points, labels))
    metric = {"unit": "m", "factor": 0.5, "scale_mode": "number", "camera_distance": 3.0}
    write_json(tmp_path / "metric.json", metric | {"region": REGION.as_dict()})
    found = {}
    for name, place in {"wood": None, "config": [1.8, 0.0]}.items():
        files = {
            "segmented": "segmented.ply",
            "metric": "metric.json",
            "contracted": f"{name}.ply",
            "removed": f"{name}_removed.ply",
            "report": f"{name}_contract.json",
            "target": f"{name}.json",
        }
        paths = {option: str(tmp_path / file) for option, file in files.items()}
        run_stage("contract_cloud", **paths, target_xy=place)
        found[name] = read_json(tmp_path / f"{name}.json")
        base = read_json(tmp_path / f"{name}_contract.json")["base"]
        assert base[:2] == pytest.approx(found[name]["target_xy"], abs=1e-5)
    for name, x in (("wood", -0.3), ("config", 0.9)):
        assert found[name]["source"] == name
        assert found[name]["target_xy"] == pytest.approx([x, 0], abs=0.03)
        assert found[name]["region"]["radius"] == REGION.radius
        assert {key: found[name][key] for key in metric} == metric
    assert found["wood"]["runner_up"]["crop_target_xy"] == pytest.approx([1.8, 0], abs=0.06)
    assert found["config"]["margin"] is None


def test_wood_that_hangs_on_no_stem_is_an_error():
    with pytest.raises(StageError) as caught:
        choose_target(np.zeros((5, 3)), [np.zeros(3)], np.full(5, -1))
    assert caught.value.key == "segment"
