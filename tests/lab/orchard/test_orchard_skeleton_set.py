"""Weber and Penn trees, points on tubes, and the paper's set of 50 trees."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.skeleton.axes import node_order
from cherrypicker_lab.orchard.grow.growth import Axis, Tree, trunk_end_node
from cherrypicker_lab.orchard.grow.templates import TEMPLATES, grow_any
from cherrypicker_lab.orchard.grow.weber_penn import shape_ratio
from cherrypicker_lab.orchard.seen.tubes import inside_wood, sample_tubes
from cherrypicker_lab.orchard.skeleton_set import (
    DENSITY,
    HOLE_RADIUS_M,
    NOISE_M,
    SIGMA_D_M,
    TIP_RADIUS_M,
    make_set_tree,
    noisy_surface,
)


def straight(radius_a, radius_b, *, start=(0, 0, 0), along=(0, 0, 1), length=1.0, **place):
    s = np.linspace(0, length, int(round(100 * length)) + 1)
    points = np.asarray(start, float) + s[:, None] * np.asarray(along, float)
    return Axis(points, np.interp(s, [0, length], [radius_a, radius_b]), **{"order": 0, **place})


@pytest.fixture(scope="module")
def trees():
    return {name: [grow_any(seed, name) for seed in (1, 2)] for name in TEMPLATES}


@pytest.mark.parametrize("name", TEMPLATES)
def test_template_is_one_rooted_tree_of_falling_radii(trees, name):
    for tree in trees[name]:
        skeleton = tree.skeleton()
        assert (skeleton.parent == -1).sum() == 1
        assert (skeleton.parent[1:] < np.arange(1, len(skeleton.parent))).all()
        assert np.isfinite(skeleton.points).all()
        assert skeleton.edge_length.max() < 0.02
        for axis in tree.axes[1:]:
            parent = tree.axes[axis.parent]
            np.testing.assert_array_equal(axis.points[0], parent.points[axis.parent_node])
            assert axis.radii[0] <= parent.radii[axis.parent_node]
            assert axis.order == parent.order + 1
            # a stub has a collar, and burls swell
            assert axis.is_cut or axis.section is not None or (np.diff(axis.radii) <= 1e-12).all()


@pytest.mark.parametrize("name", TEMPLATES)
def test_template_has_the_asked_size_and_tips(trees, name):
    low, high = TEMPLATES[name].tip_radius
    for tree in trees[name]:
        skeleton = tree.skeleton()
        n_children = np.bincount(skeleton.parent[1:], minlength=len(skeleton.parent))
        cuts = [axis.points[-1] for axis in tree.axes if axis.is_cut]
        is_tip = (n_children == 0) & ~np.isin(skeleton.points[:, 0], [p[0] for p in cuts])
        tips = skeleton.radius[is_tip]
        assert low <= tips.min()
        assert tips.max() <= high
        assert 0.9 < skeleton.points[:, 2].max() < 6.0
    small = grow_any(1, name, height=2.0, trunk_radius=0.04)
    assert small.axes[0].radii[-1] < 0.04 < small.axes[0].radii[0]
    assert small.skeleton().points[:, 2].max() == pytest.approx(2.0, rel=0.35)


def test_templates_differ_where_their_names_say(trees):
    def angle(tree):
        heads = [a.tangents[0, 2] for a in tree.axes if a.parent == 0]
        return np.degrees(np.arccos(np.mean(heads)))

    assert trees["cherry_vase"][0].axes[0].points[-1, 2] < 0.45 * 5.0
    assert angle(trees["cherry_vase"][0]) < angle(trees["cherry_leader"][0])
    assert angle(trees["cherry_leader"][0]) < angle(trees["cherry_spindle"][0])
    assert len(trees["cherry_whip"][0].axes) < 0.3 * len(trees["cherry_leader"][0].axes)
    # a fir is widest at its foot
    points = trees["fir"][0].skeleton().points
    height = points[:, 2].max()
    out = np.hypot(points[:, 0], points[:, 1])
    assert out[points[:, 2] < 0.4 * height].max() > 1.5 * out[points[:, 2] > 0.8 * height].max()


@pytest.mark.parametrize("name", TEMPLATES)
def test_trunk_and_orders_are_those_that_the_skeleton_stage_finds(trees, name):
    for tree in trees[name]:
        stem = tree.axes[0]
        children = [a for a in tree.axes if a.parent == 0]
        assert trunk_end_node(stem, [a.parent_node for a in children], children) == (
            len(stem.points) - 1
        )
        skeleton = tree.skeleton()
        order, length = node_order(skeleton), skeleton.edge_length
        true = skeleton.fields["order"]
        assert ((order == 0) == (true == 0)) @ length > 0.99 * length.sum()
        assert (order == true) @ length > 0.95 * length.sum()


def test_shapes_of_the_paper():
    assert shape_ratio(0, 0.0) == pytest.approx(0.2)
    assert shape_ratio(3, 0.3) == pytest.approx(1.0)
    assert shape_ratio(4, 0.5) == pytest.approx(0.75)


def test_a_cone_is_sampled_evenly_and_exactly():
    tree = Tree("cone", [straight(0.06, 0.02)])
    sample = sample_tubes(np.random.default_rng(0), tree, 200_000)
    tube = sample.points[:, 2] < 1.0
    area = np.pi * (0.06 + 0.02) * np.hypot(1.0, 0.04)
    assert tube.sum() == pytest.approx(200_000 * area, rel=0.02)
    np.testing.assert_allclose(
        np.hypot(*sample.points[tube, :2].T), 0.06 - 0.04 * sample.points[tube, 2], atol=1e-9
    )
    # as many points a unit of area at the thick end as at the thin one
    low, high = (sample.s[tube] < 0.1).sum(), (sample.s[tube] > 0.9).sum()
    assert low / high == pytest.approx(0.058 / 0.022, rel=0.08)
    assert ((sample.normals[tube, :2] * sample.points[tube, :2]).sum(1) > 0).all()
    assert sample.points[:, 2].max() == pytest.approx(1.02, abs=0.002)


def test_nothing_lies_inside_other_wood():
    stem = straight(0.05, 0.05)
    side = straight(
        0.02, 0.02, start=(0, 0, 0.5), along=(1, 0, 0), length=0.5, order=1, parent=0,
        parent_node=50,
    )  # fmt: skip
    sample = sample_tubes(np.random.default_rng(0), Tree("t", [stem, side]), 200_000)
    on_side = sample.axis == 1
    assert np.hypot(*sample.points[on_side, :2].T).min() >= 0.98 * 0.05 - 1e-9
    off_axis = np.hypot(sample.points[~on_side, 1], sample.points[~on_side, 2] - 0.5)
    outward = sample.points[~on_side, 0] > 0.04
    assert off_axis[outward].min() >= 0.98 * 0.02 - 1e-9
    probe = np.array([[0.0, 0.0, 0.3], [0.3, 0.0, 0.51], [0.3, 0.0, 0.53], [0.07, 0.0, 0.3]])
    tree = Tree("t", [stem, side])
    assert inside_wood(tree, probe, np.full(4, -1)).tolist() == [True, True, False, False]
    assert inside_wood(tree, probe, np.array([0, 1, 1, 0])).tolist() == [False] * 4


def test_spacing_of_the_samples_is_sigma_d():
    assert pytest.approx(0.00158, abs=1e-5) == SIGMA_D_M
    assert pytest.approx(0.0047, abs=1e-4) == NOISE_M
    # far from edges, on wood so thick that it is locally flat
    sample = sample_tubes(np.random.default_rng(1), Tree("t", [straight(0.15, 0.15)]), DENSITY)
    middle = np.abs(sample.points[:, 2] - 0.5) < 0.4
    gap = cKDTree(sample.points).query(sample.points[middle], k=2)[0][:, 1]
    assert gap.mean() == pytest.approx(SIGMA_D_M, rel=0.02)


@pytest.fixture(scope="module")
def set_tree():
    return make_set_tree(3, 2)


def test_noise_has_three_times_the_spacing():
    tree = Tree("t", [straight(0.15, 0.15)])
    points, labels = noisy_surface(np.random.default_rng(0), tree)
    middle = np.abs(points[:, 2] - 0.5) < 0.4
    off = np.hypot(*points[middle, :2].T) - 0.15
    assert off.std() == pytest.approx(3 * SIGMA_D_M, rel=0.02)
    # the noise across the radius bends away from the axis by sigma^2 / 2r
    assert off.mean() == pytest.approx(NOISE_M**2 / 0.3, abs=5e-5)
    assert (labels == Label.TRUNK).all()


def test_set_tree_has_its_size_classes_and_tips(set_tree):
    assert 15_000 < len(set_tree.noise) < 60_000
    assert set(np.unique(set_tree.noise["label"])) == {Label.TRUNK, Label.BRANCH}
    assert set_tree.skeleton.fields["order"].max() >= 3
    n_children = np.bincount(set_tree.skeleton.parent[1:], minlength=len(set_tree.skeleton.radius))
    tips = set_tree.skeleton.radius[n_children == 0]
    assert tips.min() >= TIP_RADIUS_M[0]
    assert tips.max() <= TIP_RADIUS_M[1]


def test_holes_are_holes_and_nothing_else_changes(set_tree):
    centres = set_tree.hole_centres
    assert len(centres) == 6
    assert cKDTree(centres).query(set_tree.holes.points)[0].min() > HOLE_RADIUS_M
    assert cKDTree(centres).query(centres, k=2)[0][:, 1].min() >= HOLE_RADIUS_M
    gone = cKDTree(centres).query(set_tree.noise.points)[0] <= HOLE_RADIUS_M
    assert gone.sum() == len(set_tree.noise) - len(set_tree.holes)
    trunk = set_tree.noise["label"] == Label.TRUNK
    assert (cKDTree(set_tree.noise.points[trunk]).query(centres)[0] == 0).all()


def test_set_is_reproducible_and_turns_through_the_templates():
    trees = [make_set_tree(7, number) for number in range(3)]
    assert [t.name for t in trees] == ["fir_00", "larch_01", "pine_02"]
    again = make_set_tree(7, 1)
    assert again.noise.points.tobytes() == trees[1].noise.points.tobytes()
    assert again.holes.points.tobytes() == trees[1].holes.points.tobytes()
    assert not np.array_equal(make_set_tree(8, 1).hole_centres, trees[1].hole_centres)
