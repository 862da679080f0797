"""Stems are traced to where the rule of the labels ends the trunk."""

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker.geometry.sampling import thin_to_limit
from cherrypicker.segmentation.spheres import TreeFrame
from cherrypicker.segmentation.stems import StemModel, relabel_wood, trace_stems

FRAME = TreeFrame(np.zeros(3), 1.0)


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
    points, rows, _, _ = thin_to_limit(points, 0.006, len(points))
    part, labels = part[rows], np.full(len(points), Label.BRANCH, np.uint8)
    (stem,), loose = trace_stems(points, labels, _ground(rng), StemModel())
    assert not loose.any()
    top = stem.points[-1]
    assert top[2] == pytest.approx(1.7 if goes_on else 0.8, abs=0.06)
    assert np.median(stem.radius[: len(stem.radius) // 3]) == pytest.approx(0.040, abs=0.002)
    chosen = np.zeros(len(points), bool)
    chosen[stem.rows] = stem.is_trunk
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
    after = relabel_wood(everything, labels, FRAME)
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
    after = relabel_wood(points, labels, FRAME)
    assert (after[hidden] == Label.CALIBRATION_UNIT).all()
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
    after = relabel_wood(points, np.full(len(points), Label.TRUNK, np.uint8), FRAME)
    assert (after[is_stem] == Label.TRUNK).mean() > 0.95
    assert (after[~is_stem] == Label.BRANCH).mean() > 0.9


def test_every_stem_of_the_scene_is_trunk():
    rng = np.random.default_rng(4)
    one, part_one = _fork(rng, 0.6, (-0.9, 0.0))
    two, part_two = _fork(rng, 0.6, (0.9, 0.3))
    labels = np.full(len(one) + len(two), Label.BRANCH, np.uint8)
    stems, _ = trace_stems(np.vstack([one, two]), labels, _ground(rng), StemModel())
    assert sorted(round(stem.points[0, 0], 1) for stem in stems) == [-0.9, 0.9]
    after = relabel_wood(np.vstack([one, two]), labels, FRAME) == Label.TRUNK
    part = np.concatenate([part_one, part_two])
    assert after[part == 0].mean() > 0.96 and after[part > 0].mean() < 0.08


def test_wood_that_no_stem_carries_is_branch():
    rng = np.random.default_rng(5)
    tree, part = _fork(rng, 0.7)
    stray = _tube(rng, (2.0, 2.0, 1.4), (2.3, 2.2, 1.9), 0.012, 0.006)
    labels = np.full(len(tree) + len(stray), Label.TRUNK, np.uint8)
    after = relabel_wood(np.vstack([tree, stray]), labels, FRAME)
    assert (after[len(tree) :] == Label.BRANCH).all()


def test_without_a_stem_the_labels_stay():
    rng = np.random.default_rng(6)
    points = rng.random((30, 3))
    labels = rng.choice([Label.TRUNK, Label.BRANCH], 30).astype(np.uint8)
    assert (relabel_wood(points, labels, FRAME) == labels).all()
    empty = relabel_wood(np.empty((0, 3)), np.empty(0, np.uint8), FRAME)
    assert len(empty) == 0


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
    after = relabel_wood(points, labels, FRAME, colors=colors)[: len(stem)]
    assert (after[off < 0.015] == Label.CALIBRATION_UNIT).mean() > 0.95
    assert (after[off > 0.035] == Label.TRUNK).mean() > 0.999


def test_the_trunk_goes_on_over_the_lowest_arm_of_a_head():
    """And not into another; where arms leave as one a tube is smooth, and a draw in four fails."""
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
        after = relabel_wood(points, np.full(len(points), Label.BRANCH, np.uint8), FRAME)
        assert (after[: len(stem)] == Label.TRUNK).mean() > 0.95
        in_arms.append((after[len(stem) :] == Label.TRUNK).mean())
    assert np.mean(np.array(in_arms) < 0.05) >= 0.75


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
    found = relabel_wood(points, labels, FRAME)
    assert (found[foot] == Label.TRUNK).mean() > 0.9
    assert (found[len(stem) :] == Label.GROUND).all()
