"""Stems are traced to where the rule of the labels ends the trunk."""

from functools import partial

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker.limbs.growth import Limbs
from cherrypicker.limbs.orchard import grow_orchard
from cherrypicker.limbs.tubes import Limb, Tube
from cherrypicker.pointcloud import PointCloud
from cherrypicker.segmentation import stems
from cherrypicker.segmentation.stems import (
    follow_down,
    label_wood,
    limbs_decide,
    on_things,
    poles_and_wires,
    said_posts,
    under_stems,
)
from cherrypicker.wood.thinned import GrowthOptions

FINE = GrowthOptions(voxel_size_m=0.006)


def _relabel(points, labels, *, colors=None, known=None):
    """Labels after the limbs have decided, and the limbs."""
    cloud = PointCloud(points, colors=colors, fields={"label": labels.copy()})
    orchard = grow_orchard(cloud, FINE)
    known = np.zeros(len(points), bool) if known is None else known
    label_wood(cloud, orchard, known=known, stem_gap_m=0.6)
    return cloud["label"], orchard


def _tube(rng, start, end, radius_start, radius_end, noise=0.001, spacing=0.004):
    """Surface points of a straight tapered tube."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    length = np.linalg.norm(end - start)
    n = int(2 * np.pi * 0.5 * (radius_start + radius_end) * length / spacing**2)
    t, turn = rng.random(n), rng.uniform(0, 2 * np.pi, n)
    along = (end - start) / length
    u = np.cross(along, [0.3, 1.0, 0.2])
    u /= np.linalg.norm(u)
    out = np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * np.cross(along, u)
    radius = radius_start + (radius_end - radius_start) * t + rng.normal(0, noise, n)
    return start + t[:, None] * (end - start) + radius[:, None] * out


def _ground(rng, half=1.2):
    return np.column_stack([rng.uniform(-half, half, (4000, 2)), rng.normal(0, 0.003, 4000)])


def _fork(rng, ratio, shift=(0.0, 0.0)):
    """A stem of 40 mm that forks at 0.8 m into arms of `ratio` and half of its radius."""
    x, y = shift
    parts = [
        _tube(rng, (x, y, 0), (x, y, 0.8), 0.040, 0.040),
        _tube(rng, (x, y, 0.8), (x + 0.30, y, 1.7), 0.040 * ratio, 0.034 * ratio),
        _tube(rng, (x, y, 0.8), (x - 0.45, y, 1.4), 0.020, 0.016),
    ]
    return np.vstack(parts), np.repeat([0, 1, 2], [len(p) for p in parts])


@pytest.mark.parametrize(("ratio", "goes_on"), [(0.70, False), (0.90, True)])
def test_trunk_ends_at_a_fork_that_no_arm_keeps_the_thickness_of(ratio, goes_on):
    rng = np.random.default_rng(0)
    points, part = _fork(rng, ratio)
    after, orchard = _relabel(points, np.full(len(points), Label.BRANCH, np.uint8))
    (limbs,) = orchard.limbs
    assert np.median(limbs.limbs[0].tube.radius[:5]) == pytest.approx(0.040, abs=0.002)
    chosen = after == Label.TRUNK
    top = np.quantile(points[chosen, 2], 0.99)
    assert top == pytest.approx(1.7 if goes_on else 0.8, abs=0.06)
    assert chosen[part == 0].mean() > 0.97
    assert chosen[part == 1].mean() == pytest.approx(float(goes_on), abs=0.08)
    assert chosen[part == 2].mean() < 0.08


def test_a_leaning_leader_is_trunk_to_its_tip_and_its_laterals_are_not():
    rng = np.random.default_rng(1)
    stem = _tube(rng, (0, 0, 0), (0.7, 0.1, 1.9), 0.035, 0.006)
    laterals = [
        _tube(rng, (0.35 * z, 0.05 * z, z), (0.35 * z + dx, dy, z + 0.15), 0.010, 0.004)
        for z, dx, dy in ((0.5, -0.4, 0.1), (0.8, 0.4, 0.3), (1.1, -0.3, -0.3), (1.4, 0.2, 0.3))
    ]
    points = np.vstack([stem, *laterals])
    ground = _ground(rng)
    ground = ground[np.hypot(*ground[:, :2].T) > 0.06]  # none lies within the stem
    labels = np.full(len(points), Label.BRANCH, np.uint8)
    everything = np.vstack([points, ground])
    labels = np.concatenate([labels, np.full(len(ground), Label.GROUND, np.uint8)])
    after = _relabel(everything, labels)[0]
    assert (after[: len(stem)] == Label.TRUNK).mean() > 0.95
    assert (after[len(stem) : len(points)] == Label.BRANCH).mean() > 0.92
    assert (after[len(points) :] == Label.GROUND).all()
    assert (labels[: len(stem)] == Label.BRANCH).all()  # the input is untouched


def test_a_gap_that_a_ring_hides_is_bridged_and_the_ring_keeps_its_label():
    rng = np.random.default_rng(2)
    points, part = _fork(rng, 0.7)
    hidden = (points[:, 2] > 0.40) & (points[:, 2] < 0.46)
    labels = np.full(len(points), Label.BRANCH, np.uint8)
    labels[hidden] = Label.CALIBRATION_UNIT
    colors = np.where(hidden, 0.9, 0.35)[:, None] + rng.normal(0, 0.02, (len(points), 3))
    after = _relabel(points, labels, colors=colors)[0]
    assert (after[hidden] == Label.CALIBRATION_UNIT).mean() > 0.98
    assert (after[(part == 0) & ~hidden] == Label.TRUNK).mean() > 0.96


@pytest.mark.parametrize("low", [0.30, 0.55])
def test_a_large_hole_in_the_stem_is_crossed_along_its_course(low):
    rng = np.random.default_rng(3)
    stem = _tube(rng, (0, 0, 0), (0, 0, 2.0), 0.04, 0.01)
    side = _tube(rng, (0, 0, 1.2), (0.5, 0.2, 1.0), 0.010, 0.005)
    points = np.vstack([stem, side])
    seen = (points[:, 2] < low) | (points[:, 2] > low + 0.35)
    is_stem = (np.arange(len(points)) < len(stem))[seen]
    points = points[seen]
    after = _relabel(points, np.full(len(points), Label.TRUNK, np.uint8))[0]
    assert (after[is_stem] == Label.TRUNK).mean() > 0.95
    assert (after[~is_stem] == Label.BRANCH).mean() > 0.9


def test_every_stem_of_the_scene_is_trunk():
    rng = np.random.default_rng(4)
    one, part_one = _fork(rng, 0.6, (-0.9, 0.0))
    two, part_two = _fork(rng, 0.6, (0.9, 0.3))
    labels = np.full(len(one) + len(two), Label.BRANCH, np.uint8)
    after, orchard = _relabel(np.vstack([one, two]), labels)
    assert sorted(round(base[0], 1) for base in orchard.bases) == [-0.9, 0.9]
    after = after == Label.TRUNK
    part = np.concatenate([part_one, part_two])
    assert after[part == 0].mean() > 0.96 and after[part > 0].mean() < 0.08


def test_what_lies_in_a_limb_is_wood_unless_its_class_is_a_fact():
    rng = np.random.default_rng(6)
    tree, part = _fork(rng, 0.7)
    cube = rng.uniform([0.3, 0.3, 0.0], [0.5, 0.5, 0.2], (2000, 3))
    points = np.vstack([tree, cube])
    labels = np.repeat([Label.BRANCH, Label.CALIBRATION_UNIT], [len(tree), len(cube)])
    labels = labels.astype(np.uint8)
    low = np.append((part == 0) & (np.abs(tree[:, 2] - 0.4) < 0.08), np.zeros(len(cube), bool))
    labels[low] = Label.SIGN
    after, orchard = _relabel(points, labels)
    assert (after[low] == Label.TRUNK).mean() > 0.95 and (orchard.owner[low] == 0).mean() > 0.95
    assert (after[len(tree) :] == Label.CALIBRATION_UNIT).all()
    after, _ = _relabel(points, labels, known=low)
    assert (after[low] == Label.SIGN).all()


def test_a_stem_that_ends_in_the_air_goes_on_down_through_what_stands_there():
    rng = np.random.default_rng(9)
    tree, part = _fork(rng, 0.7)
    ground = _ground(rng)
    ground = ground[np.hypot(*ground[:, :2].T) > 0.06]
    points = np.vstack([tree, ground])
    labels = np.repeat([Label.BRANCH, Label.GROUND], [len(tree), len(ground)]).astype(np.uint8)
    foot = np.append((part == 0) & (tree[:, 2] < 0.42), np.zeros(len(ground), bool))
    labels[foot] = Label.CALIBRATION_UNIT
    after, orchard = _relabel(points, labels)
    assert (after[foot] == Label.TRUNK).mean() > 0.95
    assert orchard.limbs[0].limbs[0].tube.nodes[0, 2] == pytest.approx(0.0, abs=0.01)
    seen = ~foot | (points[:, 2] > 0.38)  # nothing is there for 0.38 m: still one stem's gap
    after, orchard = _relabel(points[seen], labels[seen])
    assert orchard.limbs[0].limbs[0].tube.nodes[0, 2] == pytest.approx(0.0, abs=0.01)
    assert (after[labels[seen] == Label.GROUND] == Label.GROUND).all()


def test_a_ring_is_as_wide_as_it_is_white():
    rng = np.random.default_rng(8)
    stem = _tube(rng, (0, 0, 0), (0, 0, 1.2), 0.05, 0.045)
    off = np.abs(stem[:, 2] - 0.6)
    colors = np.where(off < 0.02, 0.9, 0.35)[:, None] + rng.normal(0, 0.02, (len(stem), 3))
    seen = np.where(off < 0.05, Label.CALIBRATION_UNIT, Label.TRUNK)  # the network's voxels
    ground = _ground(rng)
    points = np.vstack([stem, ground])
    labels = np.concatenate([seen, np.full(len(ground), Label.GROUND)]).astype(np.uint8)
    colors = np.vstack([colors, np.full((len(ground), 3), 0.3)])
    after = _relabel(points, labels, colors=colors)[0][: len(stem)]
    assert (after[off < 0.015] == Label.CALIBRATION_UNIT).mean() > 0.95
    assert (after[off > 0.035] == Label.TRUNK).mean() > 0.999


def test_the_trunk_goes_on_over_the_lowest_arm_of_a_head():
    """And not into another; where arms leave as one a tube is smooth, and a draw in eight fails."""
    in_arms = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        stem = _tube(rng, (0, 0, 0), (0, 0, 0.85), 0.05, 0.05)
        arms = [
            _tube(rng, (0, 0, 0.70), (0.5, 0, 1.2), 0.028, 0.015),
            _tube(rng, (0, 0, 0.85), (0, 0.2, 1.7), 0.028, 0.015),
            _tube(rng, (0, 0, 0.85), (-0.4, -0.2, 1.5), 0.026, 0.015),
        ]
        points = np.vstack([stem, *arms])
        after = _relabel(points, np.full(len(points), Label.BRANCH, np.uint8))[0]
        assert (after[: len(stem)] == Label.TRUNK).mean() > 0.95
        in_arms.append((after[len(stem) :] == Label.TRUNK).mean())
    # The crotch alone is .03 to .07 of the arms, a whole arm .4
    assert np.mean(np.array(in_arms) < 0.1) >= 0.85


def test_a_foot_that_passes_for_ground_in_grass_is_trunk():
    rng = np.random.default_rng(3)
    stem, _ = _fork(rng, 0.70)
    ground = _ground(rng)
    ground = ground[np.hypot(*ground[:, :2].T) > 0.05]
    points = np.vstack([stem, ground])
    labels = np.repeat([Label.BRANCH, Label.GROUND], [len(stem), len(ground)]).astype(np.uint8)
    foot = np.arange(len(points)) < len(stem)
    foot &= points[:, 2] < 0.06
    labels[foot] = Label.GROUND
    found = _relabel(points, labels)[0]
    assert (found[foot] == Label.TRUNK).mean() > 0.9
    assert (found[len(stem) :] == Label.GROUND).all()


def test_a_stem_that_is_traced_aslant_into_the_ground_begins_where_it_meets_it():
    upright = [[0, 0, z] for z in (0.01, 0.2, 0.6, 1.0)]
    nodes = np.array([[-0.11, 0, -0.1], [-0.01, 0, 0.0], *upright])
    limbs = Limbs([Limb(Tube(nodes, np.full(6, 0.05)), -1)], np.zeros(0, int), 0.004, 0.001, 1.0)
    ground = _ground(np.random.default_rng(0))
    follow_down(np.empty((0, 3)), limbs, ground, 0.6)
    tube = limbs.limbs[0].tube
    assert tube.nodes[0] == pytest.approx([-0.01, 0, 0], abs=0.002)
    left = np.linalg.norm(np.diff(nodes[1:], axis=0), axis=1).sum()
    assert tube.length == pytest.approx(left, abs=0.003)


def test_grass_that_a_twig_hangs_into_stays_ground():
    rng = np.random.default_rng(5)
    points, part = _fork(rng, 0.7)
    labels = np.full(len(points), Label.BRANCH, np.uint8)
    grass = (part == 2) & (points[:, 2] > 1.1) & (points[:, 2] < 1.2)
    labels[grass] = Label.GROUND
    after, _ = _relabel(points, labels)
    assert (after[grass] == Label.GROUND).mean() > 0.9
    assert (after[(part == 2) & ~grass] == Label.BRANCH).mean() > 0.9


def _leader(rng):
    """A stem that tapers, with a level branch."""
    return np.vstack(
        [
            _tube(rng, (0, 0, 0), (0, 0, 1.6), 0.030, 0.010),
            _tube(rng, (0, 0, 0.9), (0.5, 0.1, 1.0), 0.012, 0.006),
        ]
    )


def _found(points, label, known=None, likely=0.1):
    """Posts and stems (n,), bool, among limbs grown on what looks like wood or a post."""
    known = np.zeros(len(points), bool) if known is None else known
    said = label == Label.SUPPORT_POST
    cloud = PointCloud(points, fields={"label": np.where(said, np.uint8(Label.BRANCH), label)})
    post = np.where(said, 0.9, likely)
    is_post, is_stem = np.zeros((2, len(points)), bool)
    is_post[poles_and_wires(cloud, grow_orchard(cloud, FINE), post=post, known=known)] = True
    cloud["label"][is_post] = Label.SUPPORT_POST
    posts, stems = said_posts(cloud, grow_orchard(cloud, FINE), said)
    is_post[posts], is_stem[stems] = True, True
    return is_post, is_stem


def _is_post(points, label, known=None, likely=0.1):
    return _found(points, label, known, likely)[0]


@pytest.mark.parametrize("lean", [0.0, 0.15])
def test_a_post_beside_a_stem_is_known_by_its_shape_to_both_ends(lean):
    rng = np.random.default_rng(4)
    wood = _leader(rng)
    post = _tube(rng, (0.07, 0.02, 0), (0.07 + lean, 0.02, 1.3), 0.02, 0.02)
    points = np.vstack([wood, post])
    is_post = _is_post(points, np.full(len(points), Label.BRANCH, np.uint8))
    assert is_post[len(wood) :].mean() > 0.95
    assert is_post[: len(wood)].mean() < 0.05
    # A stem can be as straight: where the network is sure of wood it is wood
    assert not _is_post(points, np.full(len(points), Label.BRANCH, np.uint8), likely=0.01).any()


def test_a_stake_that_the_stems_limb_follows_is_a_post_and_the_wood_still_stands():
    rng = np.random.default_rng(4)
    stem = _tube(rng, (0, 0, 0), (0, 0, 1.3), 0.05, 0.03)
    branches = [
        _tube(rng, (0, 0, z), (-0.7 * np.cos(a), 0.7 * np.sin(a), z + 0.1), 0.015, 0.01)
        for z, a in ((0.5, 0.0), (0.7, 0.8), (0.9, -0.8))
    ]
    stake = _tube(rng, (0.09, 0, 0), (0.09, 0, 1.9), 0.02, 0.02)
    parts = [stem, stake, *branches, _ground(rng)]
    points, part = np.vstack(parts), np.repeat(range(6), [len(one) for one in parts])
    label = np.where(part == 5, Label.GROUND, Label.BRANCH).astype(np.uint8)
    cloud = PointCloud(points, fields={"label": label})
    orchard, none = grow_orchard(cloud, FINE), np.zeros(len(points), bool)
    ways = [[(0, 0, 0), (0, 0, 1.3), (0.09, 0, 1.35), (0.09, 0, 1.9)]]
    ways += [[one[0], one[-1]] for one in branches]
    nodes = [np.concatenate([np.linspace(*ends, 40) for ends in zip(w, w[1:])]) for w in ways]
    radius = [np.where(nodes[0][:, 0] > 0.05, 0.02, 0.04), *[np.full(40, 0.012)] * 3]
    limbs = [
        Limb(Tube(*each), min(number, 1) - 1) for number, each in enumerate(zip(nodes, radius))
    ]
    wood = np.flatnonzero(part < 5)
    orchard.limbs = [Limbs(limbs, np.maximum(part[wood] - 1, 0), 0.004, 0.001, 1.0)]
    orchard.entered, orchard.owner[wood] = [wood], 0
    found = poles_and_wires(cloud, orchard, post=np.full(len(points), 0.1), known=none)
    assert np.isin(np.flatnonzero(part == 1), found).mean() > 0.95
    assert np.isin(np.flatnonzero(part == 0), found).mean() < 0.1


def test_poles_are_looked_for_until_none_is_found(monkeypatch):
    """Limbs that are grown without the posts follow a wire that they did not follow before."""
    points = _leader(np.random.default_rng(4))
    cloud = PointCloud(points, fields={"label": np.full(len(points), Label.BRANCH, np.uint8)})
    branch = np.flatnonzero((points[:, 0] > 0.2) & (points[:, 2] > 0.8))
    finds, none = [branch[:50], branch[50:80], branch[:0]], np.zeros(len(points), bool)
    monkeypatch.setattr(stems, "poles_and_wires", lambda *args, **known: finds.pop(0))
    grow, post = partial(grow_orchard, options=FINE), np.zeros(len(points))
    limbs_decide(cloud, grow, post=post, known=~none, stem_gap_m=0.6)
    assert not finds
    assert (cloud["label"][branch[:80]] == Label.SUPPORT_POST).all()


def test_a_thin_whip_that_tapers_by_less_than_a_wire_may_is_no_post():
    rng = np.random.default_rng(4)
    whip = _tube(rng, (0.5, 0.3, 0), (0.5, 0.3, 2.0), 0.0115, 0.0085, noise=0.0005)
    points = np.vstack([_leader(rng), whip])
    assert not _is_post(points, np.full(len(points), Label.BRANCH, np.uint8)).any()


def test_an_even_upright_shoot_in_the_air_is_no_post():
    rng = np.random.default_rng(4)
    shoot = _tube(rng, (0.25, 0.05, 0.955), (0.25, 0.05, 1.25), 0.006, 0.006, noise=0.0003)
    points = np.vstack([_leader(rng), shoot, rng.uniform((-1, -1, 0), (1, 1, 0.01), (3000, 3))])
    label = np.full(len(points), Label.BRANCH, np.uint8)
    label[-3000:] = Label.GROUND
    assert not _is_post(points, label).any()


def test_a_leader_is_no_post_and_a_leaning_pole_is_but_for_what_is_known():
    rng = np.random.default_rng(4)
    wood = _leader(rng)
    pole = _tube(rng, (0.3, 0, 0), (1.2, 0, 1.0), 0.02, 0.02)
    points = np.vstack([wood, pole])
    label = np.full(len(points), Label.BRANCH, np.uint8)
    is_pole = np.arange(len(points)) >= len(wood)
    label[is_pole & (points[:, 2] > 0.8)] = Label.SIGN
    for known in (np.zeros(len(points), bool), label == Label.SIGN):
        found = _is_post(points, label, known)
        assert found[is_pole & ~known].mean() > 0.9
        assert not found[known].any()
        assert found[~is_pole].mean() < 0.01


@pytest.mark.parametrize("low", [1.5, 0.2])
@pytest.mark.parametrize("said", [False, True])
def test_a_stem_as_even_as_a_pole_is_one_while_wood_would_hang_without_it(said, low):
    rng = np.random.default_rng(4)
    stem = _tube(rng, (0, 0, 0), (0, 0, 1.2), 0.03, 0.03)
    boughs = [_tube(rng, (0, 0, 1.2), (x, 0.1, low), 0.012, 0.006) for x in (-0.6, 0.6)]
    ground = rng.uniform((-1, -1, 0), (1, 1, 0.01), (3000, 3))
    points = np.vstack([stem, *boughs, ground])
    label = np.full(len(points), Label.BRANCH, np.uint8)
    label[-3000:] = Label.GROUND
    if said:
        label[: len(stem)] = Label.SUPPORT_POST
    found = np.flatnonzero(_is_post(points, label))
    assert np.mean(found < len(stem)) > 0.95 if said else not len(found)


def test_a_limb_that_is_no_pole_is_a_post_where_the_network_says_so():
    rng = np.random.default_rng(4)
    wood = _leader(rng)
    post = _tube(rng, (0.3, 0, 0), (1.0, 0, 1.0), 0.03, 0.015)
    points = np.vstack([wood, post])
    label = np.full(len(points), Label.BRANCH, np.uint8)
    label[len(wood) :][rng.random(len(post)) < 0.7] = Label.SUPPORT_POST
    found = np.flatnonzero(_is_post(points, label))
    assert len(found) > 0.2 * len(post)
    assert (found >= len(wood)).all()


@pytest.mark.parametrize("is_bare", [False, True])
def test_a_tapering_stem_that_passes_for_a_post_is_a_stem_if_limbs_would_hang_without_it(is_bare):
    rng = np.random.default_rng(4)
    stem = _tube(rng, (0, 0, 0), (0, 0, 1.6), 0.030, 0.010)
    bough = _tube(rng, (0, 0, 0.9), (0.5, 0.1, 1.0), 0.012, 0.006)
    points = np.vstack([stem, _ground(rng)] if is_bare else [stem, bough, _ground(rng)])
    label = np.full(len(points), Label.BRANCH, np.uint8)
    label[: len(stem)] = Label.SUPPORT_POST
    label[-len(_ground(rng)) :] = Label.GROUND
    is_post, is_stem = _found(points, label)
    shown, other = (is_post, is_stem) if is_bare else (is_stem, is_post)
    assert shown[: len(stem)].mean() > 0.4  # those that limbs are grown from
    assert shown[len(stem) :].mean() < 0.02
    assert not other.any()


def test_what_stands_under_a_stem_and_nowhere_else_is_the_stem():
    rng = np.random.default_rng(6)
    stem = _leader(rng)
    board = rng.uniform((0.3, -0.2, 0.3), (0.31, 0.2, 0.6), (3000, 3))
    post = _tube(rng, (0.3, 0, 0), (0.3, 0, 0.3), 0.01, 0.01)
    ground = _ground(rng)
    points = np.vstack([stem, board, post, ground])
    labels = np.repeat(
        [Label.BRANCH, Label.SIGN, Label.GROUND], [len(stem), len(board) + len(post), len(ground)]
    ).astype(np.uint8)
    is_stem = np.arange(len(points)) < len(stem)
    lower = is_stem & (points[:, 2] < 0.4) & (np.hypot(*points[:, :2].T) < 0.05)
    labels[lower] = Label.SIGN
    seen = ~(lower & (points[:, 2] > 0.3))  # a gap, so that it hangs together with nothing
    cloud, lower = PointCloud(points[seen], fields={"label": labels[seen]}), lower[seen]
    orchard = grow_orchard(cloud, FINE)

    def found(known):
        return under_stems(
            cloud, orchard, known=known, grow=lambda changed: grow_orchard(changed, FINE)
        )

    assert np.array_equal(found(np.zeros(len(cloud), bool)), np.flatnonzero(lower))
    assert not len(found(lower))


def test_the_post_of_a_sign_beside_a_hanging_branch_is_no_stem():
    """Below the branch's end it is as slender as a stem; it goes on above."""
    rng = np.random.default_rng(7)
    branch = _tube(rng, (0, 0, 0.15), (0, 0, 1.2), 0.012, 0.008)
    post = _tube(rng, (0.04, 0, 0), (0.04, 0, 1.0), 0.012, 0.012)
    board = rng.uniform((0.04, -0.2, 1.0), (0.05, 0.2, 1.3), (3000, 3))
    ground = _ground(rng)
    points = np.vstack([branch, post, board, ground])
    labels = np.repeat(
        [Label.BRANCH, Label.SIGN, Label.GROUND], [len(branch), len(post) + len(board), len(ground)]
    ).astype(np.uint8)
    cloud = PointCloud(points, fields={"label": labels})
    known = np.zeros(len(cloud), bool)
    grow = partial(grow_orchard, options=FINE)
    assert not len(under_stems(cloud, grow(cloud), known=known, grow=grow))


def test_a_limb_on_what_passes_for_wood_of_a_stand_is_of_the_stand():
    rng = np.random.default_rng(8)
    stem = _leader(rng)
    branch = _tube(rng, (0, 0, 0.7), (1.0, 0.05, 0.95), 0.012, 0.008)
    stand = _tube(rng, (0.5, 0, 0), (0.5, 0, 1.2), 0.015, 0.015)
    ground = _ground(rng)
    points = np.vstack([stem, branch, stand, ground])
    passes = (stand[:, 2] > 0.7) & (stand[:, 2] < 1.0) & (rng.random(len(stand)) < 0.4)
    labels = np.concatenate(
        [
            np.full(len(stem) + len(branch), Label.BRANCH),
            np.where(passes, Label.BRANCH, Label.MARKER),
            np.full(len(ground), Label.GROUND),
        ]
    ).astype(np.uint8)
    cloud = PointCloud(points, fields={"label": labels})
    rows, kinds = on_things(cloud, grow_orchard(cloud, FINE))
    of_stand = np.zeros(len(points), bool)
    of_stand[len(stem) + len(branch) : -len(ground)] = passes
    assert of_stand[rows].mean() > 0.95 and len(rows) > 0.9 * passes.sum()
    assert (kinds == Label.MARKER).all()
