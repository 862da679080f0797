"""Cuts on small trees whose answer is known by hand, and the stage from end to end."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from finished_tree import small_skeleton, write_finished_tree
from stage_run import run_stage
from workspace import Workspace

from cherrypicker.bearing.measure import measure_bearing
from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml, read_json, write_json, write_text
from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.light.measure import LightOptions, measure_light
from cherrypicker.pruning.aims import crossings
from cherrypicker.pruning.light_left import light_left
from cherrypicker.pruning.plan import propose_cuts
from cherrypicker.pruning.standing import StandingTree
from cherrypicker.pruning.table import CUT_COLUMNS
from cherrypicker.pruning.target import OWN, PruningOptions, read_presets, resolve_target
from cherrypicker.series.changes import Gone
from cherrypicker.series.made_cuts import made_cuts
from cherrypicker.series.wood import sample_wood
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.branches import branch_rows, branches_csv, read_branches
from cherrypicker.traits.intervals import Estimate
from cherrypicker.traits.limb_table import limb_rows, ratio_terms, squares_terms
from cherrypicker.traits.scaffold import Scaffold
from cherrypicker.traits.table import LIMB_COLUMNS

STEM = 0.06  # diameter of the stem of `rods`


def rods(*limbs, height=2.0, step=0.01):
    """A straight stem of 6 cm and straight limbs on it: height of each, its end and radius."""
    n = round(height / step)
    points = [(0.0, 0.0, i * step) for i in range(n + 1)]
    parent, radius = [-1, *range(n)], [STEM / 2] * (n + 1)
    for at, end, thick in limbs:
        foot = np.array([0.0, 0.0, at])
        way = np.array(end, float) - foot
        count = round(np.linalg.norm(way) / step)
        parent += [round(at / step), *range(len(points), len(points) + count - 1)]
        points += [tuple(foot + way * (i + 1) / count) for i in range(count)]
        radius += [thick] * count
    known = {"radius_error": np.full(len(points), 1e-4), "residual": np.full(len(points), 1e-3)}
    return Skeleton(points, parent, radius, np.ones(len(points)), known)


def measured(skeleton):
    """What measure_traits says of a skeleton, as far as pruning reads it."""
    scaffold = Scaffold(skeleton, least=0.10)
    stem = {"fit": 5e-4}
    branches = branch_rows(skeleton, scaffold.axes, 0.0)
    limbs = limb_rows(scaffold, branches, STEM, 0.0)
    squares = squares_terms(scaffold.limbs)
    ratio = sum(limb.diameter**2 for limb in scaffold.limbs) / STEM**2
    area, terms = np.pi / 4 * 1e4, ratio_terms(squares, ratio, STEM, stem)
    estimates = {
        "limb_trunk_ratio": Estimate.of(ratio, terms),
        "limb_area_cm2": Estimate.of(
            area * ratio * STEM**2, {name: area * term for name, term in squares.items()}
        ),
        "tcsa_cm2": Estimate.of(STEM, stem).circle_area(),
    }
    traits = {name: each.value for name, each in estimates.items()}
    traits |= {f"{name}_se": each.se for name, each in estimates.items()}
    return branches, limbs, traits | {"foot": [0.0, 0.0, 0.0], "height_m_se": 0.01}


def standing_of(skeleton, **options):
    axis_list = axes(skeleton)
    tree = MeasuredTree("rods", skeleton, axis_list)
    return StandingTree(tree, *measured(skeleton), **options)


def proposed(skeleton, target, *, stub=0.0, preset=OWN, keep=(), light=None):
    options = PruningOptions(preset, target)
    standing = standing_of(skeleton, stub=stub)
    resolved = resolve_target(options, len(standing.limbs), skeleton.unit)
    return *propose_cuts(standing, resolved, keep=keep, light=light), standing


FOUR = [
    (0.8, (1.0, 0, 1.2), 0.020),
    (1.0, (-0.8, 0, 1.3), 0.015),
    (1.2, (0, 0.6, 1.4), 0.012),
    (1.4, (0, -0.4, 1.6), 0.008),
]


def test_the_thickest_limbs_go_until_the_ratio_is_reached_and_no_more():
    summary, rows, _ = proposed(rods(*FOUR), {"limb_trunk_ratio": 0.5})
    areas = [(2 * thick / STEM) ** 2 for *_, thick in FOUR]
    assert summary["before"]["limb_trunk_ratio"] == pytest.approx(sum(areas))
    assert [row["diameter_m"] for row in rows] == pytest.approx([0.04])
    assert rows[0]["ratio_after"] == pytest.approx(sum(areas[1:]))
    assert rows[0]["reasons"] == "over_ratio" and rows[0]["kind"] == "thinning"
    # 0.48 stand; any limb but the last would reach 0.45, the third loses less wood than the second
    _, rows, _ = proposed(rods(*FOUR), {"limb_trunk_ratio": 0.45})
    assert [row["height_m"] for row in rows] == pytest.approx([0.8, 1.4], abs=0.02)


@pytest.mark.parametrize(
    "target, n_cuts",
    [({"limb_trunk_ratio": 0.3, "height_m": 1.8}, 3), ({"row_width_m": 0.2, "height_m": 1.8}, 3)],
)
def test_what_is_left_is_what_a_new_measurement_of_the_cut_tree_finds(target, n_cuts):
    """What stays of a limb that is headed 7 cm off the stem is a stub."""
    skeleton = rods(*FOUR)
    summary, rows, standing = proposed(skeleton, target)
    cut = skeleton.select(standing.stands)
    _, limbs, traits = measured(cut)
    after = summary["after"]
    assert after["limb_trunk_ratio"] == pytest.approx(traits["limb_trunk_ratio"], rel=1e-6)
    assert after["limb_trunk_ratio_se"] == pytest.approx(traits["limb_trunk_ratio_se"], rel=0.05)
    assert after["n_limbs"] == len(limbs)
    assert after["length_m"] == pytest.approx(cut.edge_length.sum())
    assert after["height_m"] == pytest.approx(1.8, abs=0.011)
    assert all(each["is_reached"] for each in summary["targets"]) and len(rows) == n_cuts


def test_the_stem_is_cut_at_the_height_asked_for_and_nowhere_without_one():
    _, rows, standing = proposed(rods(*FOUR), {"length_m_per_cm2": 0.01, "tips_per_cm2": 0.0})
    assert standing.stands[standing.stem].all() and len(rows) == 4
    summary, _, _ = proposed(rods(*FOUR), {"length_m_per_cm2": 0.01})
    assert not summary["targets"][0]["is_reached"]
    _, rows, standing = proposed(rods(*FOUR), {"height_m": 1.5})
    heads = {row["branch_id"]: row for row in rows}
    assert heads[0]["kind"] == "heading" and heads[0]["z_m"] == pytest.approx(1.5, abs=0.011)
    assert standing.height[standing.stands].max() <= 1.5


def test_the_stem_is_the_one_of_the_table_whatever_photos_tell_of_its_radii():
    """By the photos' radii the trunk would end at the first fork, and its upper part be cut."""
    skeleton = rods(*FOUR)
    axis_list, radius = axes(skeleton), skeleton.radius.copy()
    radius[skeleton.points[:, 2] > 0.85] = 0.008
    seen = replace(
        skeleton, radius=radius, fields=skeleton.fields | {"radius_by_points": skeleton.radius}
    )
    assert len(axes(seen)[0].nodes) < len(axis_list[0].nodes)
    standing = StandingTree(MeasuredTree("seen", seen, axis_list), *measured(skeleton))
    assert np.flatnonzero(standing.stem).tolist() == axis_list[0].nodes.tolist()


@pytest.mark.parametrize(
    "limit, reason, column",
    [
        ("shoots_per_cm2", "too_many_shoots", "shoots"),
        ("bearing_length_m_per_cm2", "too_much_bearing_wood", "bearing_length_m"),
    ],
)
def test_shoots_and_bearing_wood_are_those_of_the_bearing_stage(limit, reason, column):
    skeleton = rods(*FOUR)
    _, limbs, traits = measured(skeleton)
    tree = MeasuredTree("rods", skeleton, axes(skeleton))
    whole, _ = measure_bearing(tree, limbs, traits["tcsa_cm2"])
    summary, rows, _ = proposed(skeleton, {limit: 0.7 * whole[limit]})
    assert summary["before"][column] == pytest.approx(whole[column], abs=1e-5)
    assert summary["before"][limit] == pytest.approx(whole[limit], abs=1e-5)
    assert summary["targets"][0]["is_reached"] and rows[0]["reasons"] == reason
    gone = sum(
        each[column]
        for each in whole["limbs"]
        if each["branch_id"] in {r["branch_id"] for r in rows}
    )
    left = summary["after"][column]
    assert left == pytest.approx(whole[column] - gone, abs=0.02 * whole[column])
    name = "shoots_after" if column == "shoots" else "bearing_length_after_m"
    assert rows[-1][name] == pytest.approx(left)


def test_what_is_left_is_as_sure_as_the_whole_tree():
    skeleton = rods(*FOUR)
    branches, limbs, traits = measured(skeleton)
    length = float(skeleton.edge_length.sum())
    traits |= {"total_length_m": length, "total_length_m_se": 0.1 * length}
    traits |= {"total_length_m_ci90": [0.9 * length, 1.3 * length], "tcsa_cm2_se": 0.0}
    tree = MeasuredTree("rods", skeleton, axes(skeleton))
    standing = StandingTree(tree, branches, limbs, traits)
    summary, rows = propose_cuts(
        standing, resolve_target(PruningOptions(OWN, {"length_m_per_cm2": 0.1}), 4, "m")
    )
    left = rows[-1]["length_after_m"]
    assert left < length
    ends = [rows[-1]["length_low_m"], rows[-1]["length_high_m"]]
    assert ends == pytest.approx([0.9 * left, 1.3 * left])
    target = summary["targets"][0]
    assert target["after_se"] == pytest.approx(0.1 * target["after"])
    assert summary["after"]["tips_low"] is None  # nothing told of the whole tree's


def test_what_the_user_keeps_is_planned_around():
    _, rows, _ = proposed(rods(*FOUR), {"limb_trunk_ratio": 0.55}, keep=[1])
    assert 1 not in [row["branch_id"] for row in rows] and len(rows) == 2
    with pytest.raises(StageError) as refused:
        proposed(rods(*FOUR), {"n_limbs": 1}, keep=[99])
    assert refused.value.key == "pruning.keep"


def test_a_stub_stays_and_is_no_limb():
    flush, rest = (proposed(rods(*FOUR), {"n_limbs": 3}, stub=stub) for stub in (0.0, 0.02))
    assert rest[1][0]["along_m"] == pytest.approx(flush[1][0]["along_m"] + 0.02, abs=0.011)
    cut = rods(*FOUR).select(rest[2].stands)
    assert len(measured(cut)[1]) == 3


def test_a_limb_too_wide_for_the_row_is_headed_and_one_along_it_is_not():
    _, rows, _ = proposed(rods(*FOUR), {"row_width_m": 0.9})
    assert [row["branch_id"] for row in rows] == [3]
    assert rows[0]["kind"] == "heading" and rows[0]["y_m"] == pytest.approx(0.45, abs=0.011)
    assert rows[0]["reasons"] == "over_width"


def test_limbs_to_renew_steep_and_shaded_ones_go():
    steep = [*FOUR, (1.5, (0.3, 0, 2.0), 0.006)]
    _, rows, _ = proposed(rods(*steep), {"renew_limbs": 1, "steep_deg": 40})
    assert [(row["branch_id"], row["reasons"]) for row in rows] == [(1, "renewal"), (5, "steep")]
    light = {"limbs": [{"branch_id": 2, "sky_share": 0.9, "leaf_sky_share": 0.2}]}
    _, rows, _ = proposed(rods(*FOUR), {"shaded_share": 0.3}, light=light)
    assert [(row["branch_id"], row["reasons"]) for row in rows] == [(2, "shaded")]
    with pytest.raises(StageError) as refused:
        proposed(rods(*FOUR), {"shaded_share": 0.3})
    assert refused.value.key == "light.enabled"


def test_a_target_that_leaves_no_limb_is_said_not_to_fit_the_tree():
    summary, _, _ = proposed(rods(*FOUR), {"steep_deg": 80})
    assert "no limb is left" in summary["notes"][-1]
    summary, _, _ = proposed(rods(*FOUR), {"n_limbs": 1})
    assert summary["notes"] == []


def test_of_two_that_touch_the_lesser_goes_and_a_fork_is_no_touch():
    over = (1.0, (1.0, 0.0, 1.0), 0.010)
    under = (0.8, (0.8, 0.0, 1.2), 0.006)  # meets the first where both are half a metre out
    assert len(crossings(standing_of(rods(over, under)))) == 1
    _, rows, _ = proposed(rods(over, under), {"crossing": 0})
    assert [(row["diameter_m"], row["reasons"]) for row in rows] == [
        (pytest.approx(0.012), "crossing")
    ]
    beside = (1.0, (0.9, 0.3, 1.0), 0.010)  # leaves the stem where the first does
    assert len(crossings(standing_of(rods(over, beside)))) == 0


def test_a_later_scan_tells_which_cuts_were_made_and_what_went_besides():
    skeleton = rods(*FOUR)
    _, rows, _ = proposed(skeleton, {"renew_limbs": 2})
    wood = sample_wood(skeleton)
    piece = np.full(len(wood), -1)
    # The first limb was cut 3 cm further out, the second not at all, half of the third besides
    piece[(wood.axis == 1) & (wood.along > rows[0]["along_m"] + 0.03)] = 0
    piece[(wood.axis == 3) & (wood.along > 0.3)] = 1
    step = SimpleNamespace(
        earlier=SimpleNamespace(wood=wood), gone=Gone(np.array([0, 0]), piece=piece)
    )
    told = made_cuts(step, rows)
    assert (told["made_cuts"], told["missed_cuts"], told["n_more_cuts"]) == ([1], [2], 1)
    assert told["more_length_m"] == pytest.approx(wood.length[piece == 1].sum())


def test_what_touches_a_limb_that_goes_is_let_be():
    over, under = (1.0, (1.0, 0.0, 1.0), 0.010), (0.8, (0.8, 0.0, 1.2), 0.006)
    _, rows, _ = proposed(rods(over, under), {"renew_limbs": 1, "crossing": 0})
    assert [row["reasons"] for row in rows] == ["renewal"]
    _, rows, _ = proposed(rods(over, under), {"limb_trunk_ratio": 0.05, "crossing": 0})
    assert [row["reasons"] for row in rows] == ["over_ratio"]


def test_an_axis_that_touches_twice_goes_back_until_it_touches_no_more():
    """It comes nearest further out, beyond a lateral."""
    skeleton = rods((1.0, (1.0, 0.0, 1.0), 0.010), (0.8, (0.8, 0.0, 1.2), 0.006))
    points = skeleton.points
    end = len(points)
    points[-30:] = points[-31] + 0.01 * np.arange(1, 31)[:, None] * [1.0, 0.0, -1.0]
    points[-60:, 1] = np.interp(np.arange(60), [0, 5, 27, 34], [0.0, 0.015, 0.015, 0.0])
    lateral = points[end - 33] + 0.01 * np.arange(1, 13)[:, None] * [0.0, 1.0, 1.0]
    double = Skeleton(
        np.vstack([points, lateral]),
        [*skeleton.parent, end - 33, *range(end, end + 11)],
        [*skeleton.radius, *[0.003] * 12],
        np.ones(end + 12),
    )
    _, rows, standing = proposed(double, {"crossing": 0})
    assert len(rows) == 1 and rows[0]["kind"] == "thinning" and not len(crossings(standing))


@pytest.mark.parametrize("leaf_area_cm2", [0.0, 30.0])
def test_light_after_the_cuts_is_what_a_new_measurement_of_the_cut_tree_finds(
    monkeypatch, leaf_area_cm2
):
    monkeypatch.setattr("cherrypicker.light.rays.N_RAYS", 10_000)
    skeleton = rods(*FOUR)
    _, rows, standing = proposed(skeleton, {"n_limbs": 2, "row_width_m": 0.9})
    name = "leaf_sky_share" if leaf_area_cm2 else "sky_share"
    options = LightOptions((49.6, 11.0), ("2026-06-01", "2026-06-02"), leaf_area_cm2=leaf_area_cm2)
    limbs = [1, 2, 3, 4]
    before, _ = measure_light(standing.tree, limbs, options)

    def told(light):
        prefix = name.removesuffix("sky_share")
        return [light[name], light[f"{prefix}direct_mj"] + light[f"{prefix}diffuse_mj"]]

    found = light_left(standing, rows, before)
    assert list(found) == ["sky_share", "season_mj"]
    of_tree, of_limbs = (np.array(each) for each in zip(*found.values()))
    assert of_tree.shape == (2, len(rows) + 1)
    assert of_tree[:, 0] == pytest.approx(told(before), rel=1e-4)
    in_limbs = np.transpose([told(each) for each in before["limbs"]])
    assert of_limbs[:, 0] == pytest.approx(in_limbs, rel=1e-4, abs=1e-4)
    uncut, _ = light_left(standing, [], before)["season_mj"]
    assert uncut == pytest.approx(of_tree[1, :1])
    gone = {row["branch_id"] for row in rows if row["kind"] == "thinning"}
    assert [np.isnan(each) for each in of_limbs[0, -1]] == [limb in gone for limb in limbs]
    cut = skeleton.select(standing.stands)
    axis_list = axes(cut)
    left = MeasuredTree("cut", cut, axis_list)
    after, _ = measure_light(left, [], options)
    # Leaves stand where the way on to a tip is short: a limb that is headed has other ones
    assert of_tree[:, -1] == pytest.approx(told(after), rel=0.02 if leaf_area_cm2 else 0.005)


def test_presets_name_a_source_and_are_the_schemas(project):
    presets = read_presets()
    schema = load_yaml(project / "workflow/schemas/config.schema.yaml")
    listed = schema["properties"]["pruning"]["properties"]["preset"]["enum"]
    assert set(listed) - {None, OWN} == set(presets)
    for name, preset in presets.items():
        assert preset["source"] and preset["target"], name
        target = resolve_target(PruningOptions(name, row_distance_m=3.0), 10, "m")
        assert target.limits and not target.notes, name
    spindle = resolve_target(PruningOptions("tall_spindle", {"steep_deg": 30.0}), 10, "m")
    assert spindle.limits["steep_deg"] == 30 and "height_m" not in spindle.limits and spindle.notes
    assert resolve_target(PruningOptions("tall_spindle_axe"), 14, "m").limits["renew_limbs"] == 3


@pytest.mark.parametrize(
    "options, unit, key",
    [
        (PruningOptions("espalier"), "m", "pruning.preset"),
        (PruningOptions(OWN), "m", "pruning.target"),
        (PruningOptions(OWN, {"beauty": 1.0}), "m", "pruning.target"),
        (PruningOptions("ufo"), "arbitrary", "scale.mode"),
    ],
)
def test_a_target_that_cannot_be_is_refused_by_its_key(options, unit, key):
    with pytest.raises(StageError) as refused:
        resolve_target(options, 4, unit)
    assert refused.value.key == key


def test_a_tree_without_errors_or_limbs_is_told_without():
    skeleton = rods()
    skeleton.fields = {}
    summary, rows, _ = proposed(skeleton, {"limb_trunk_ratio": 0.5, "n_limbs": 0})
    assert rows == [] and summary["after"]["limb_trunk_ratio"] == 0
    assert summary["after"]["limb_trunk_ratio_se"] is None


def test_the_stage_writes_cuts_that_read_back(tmp_path):
    folder = tmp_path / "tree"
    write_finished_tree(folder)
    skeleton = small_skeleton()
    branches, limbs, traits = measured(skeleton)
    write_text(folder / "limbs.csv", branches_csv(limbs, LIMB_COLUMNS))
    write_json(folder / "traits.json", traits)
    names = {"skeleton": "skeleton.graphml", "limbs": "limbs.csv", "traits": "traits.json"}
    names |= {"cuts": "pruning.csv", "pruning": "pruning.json"}
    files = {name: folder / file for name, file in names.items()}
    run_stage("propose_pruning", **files, preset="own", target={"n_limbs": 1})
    rows = read_branches(folder / "pruning.csv", CUT_COLUMNS)
    told = read_json(folder / "pruning.json")
    assert len(rows) == told["n_cuts"] == len(limbs) - 1 and told["targets"][0]["is_reached"]
    assert [row["cut"] for row in rows] == [*range(1, len(rows) + 1)]
    assert rows[-1]["volume_after_m3"] == pytest.approx(told["after"]["volume_m3"], abs=1e-8)


def test_cuts_are_proposed_for_the_trees_whose_config_names_a_preset(tmp_path):
    workspace = Workspace(tmp_path / "work")
    for tree in "ab":
        workspace.add_cloud(tree)
    workspace.configure({"pruning": {"preset": "ltr_100"}}, "b.yaml")
    workspace.table("tree | cloud | config", "a | a.ply | ", "b | b.ply | config/b.yaml")
    assert [tree for stage, tree in workspace.planned() if stage == "propose_pruning"] == ["b"]
