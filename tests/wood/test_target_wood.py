"""Which wood is the target's."""

import numpy as np
import pytest
from skeleton_shapes import small_tree, tube
from wood_choice import choose_wood

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.geometry.ground_surface import ground_height
from cherrypicker.geometry.sampling import farthest_point_sample, voxel_thin
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.feet import find_stems
from cherrypicker.wood.target_wood import lowest_base, share_cloud
from cherrypicker.wood.thinned import GrowthOptions


def two_trees(gap=0.9):
    """The target at the origin, a neighbour whose laterals touch or cross its crown."""
    own, own_labels, _ = small_tree(0)
    other, other_labels, _ = small_tree(1, (gap, 0.05, 0.02))
    points = np.vstack([own, other])
    _, source, _ = voxel_thin(points, 0.01)
    tree = np.concatenate([np.zeros(len(own)), np.ones(len(other))])
    labels = np.concatenate([own_labels, other_labels])
    return points[source], labels[source], tree[source]


@pytest.mark.parametrize("gap", [1.2, 0.8])
def test_neighbour_is_cut_off_even_where_crowns_touch(gap):
    points, labels, tree = two_trees(gap)
    wood = choose_wood(points, labels, target_xy=(0, 0))
    assert wood.report["n_stems"] == 2
    assert wood.keep[tree == 0].mean() > 0.97
    assert wood.keep[tree == 1].mean() < 0.03
    assert len(wood.choice.other_trees) == 1
    np.testing.assert_allclose(wood.base[:2], 0, atol=0.03)


def test_branches_labelled_ground_do_not_bury_the_foot(caplog):
    points, labels, _ = small_tree(0)
    top = points[:, 2].max()
    rng = np.random.default_rng(0)
    wrong = np.column_stack([rng.uniform(-0.4, 0.4, (60, 2)), np.full(60, 0.35 * top)])
    (stem,) = find_stems(points, wrong, labels)
    np.testing.assert_allclose(stem.base[:2], 0, atol=0.03)
    assert stem.base[2] < 0.1 * top
    assert "below what is labelled ground" in caplog.text
    caplog.clear()
    ground = wrong * [1, 1, 0]
    assert find_stems(points, ground, labels)[0].base[2] < 0.1 * top
    assert not caplog.text


def test_a_trunk_told_high_up_is_no_base_and_a_branch_that_hangs_lower_is_none():
    points, labels, _ = small_tree(0)
    height = points[:, 2] / points[:, 2].max()
    high = np.where((height > 0.6) & (height < 0.65), Label.TRUNK, Label.BRANCH)
    assert lowest_base(points, high).base[2] < 0.05 * points[:, 2].max()
    hanging = points[height > 0.5][:40] * [1, 1, 0] - [0, 0, 0.1]
    told = np.append(labels, np.full(40, Label.BRANCH))
    base = lowest_base(np.vstack([points, hanging]), told).base
    np.testing.assert_allclose(base, lowest_base(points, labels).base, atol=0.005)


def test_target_follows_target_xy():
    points, labels, tree = two_trees(1.2)
    wood = choose_wood(points, labels, target_xy=(1.2, 0))
    assert wood.keep[tree == 1].mean() > 0.97 and wood.keep[tree == 0].mean() < 0.03


def test_wood_that_comes_in_over_the_border_is_cut():
    points, labels, _ = small_tree(0)
    branch = tube((1.0, 0.03, 0.9), (0.5, 0.0, 0.78), 0.008, rng=np.random.default_rng(2))
    everything = np.vstack([points, branch])
    _, source, _ = voxel_thin(everything, 0.008)
    label = np.concatenate([labels, np.full(len(branch), 2)])[source]
    foreign = source >= len(points)
    boxed = Footprint.of_box([[-1.0, -1.0], [1.0, 1.0]])
    # at 0.6 m the laterals meet it nearer to the border than to the stem: their own ends stay
    for region in (Footprint(np.zeros(2), 1.0), boxed, Footprint(np.zeros(2), 0.6)):
        wood = choose_wood(everything[source], label, region=region)
        assert wood.keep[foreign].mean() < 0.1
        assert wood.keep[~foreign].mean() > 0.97


def test_gaps_along_a_branch_are_kept_and_far_blobs_dropped():
    points, labels, _ = small_tree(0)
    torn = np.linalg.norm(points - (0.25, 0, 0.61), axis=1) > 0.07  # a hole in the first lateral
    blob = np.random.default_rng(3).normal((-0.6, -0.6, 0.3), 0.02, (60, 3))
    everything = np.vstack([points[torn], blob])
    _, source, _ = voxel_thin(everything, 0.008)
    label = np.concatenate([labels[torn], np.full(60, 2)])[source]
    wood = choose_wood(everything[source], label)
    is_blob = source >= torn.sum()
    beyond = (everything[source][:, 0] > 0.35) & ~is_blob
    assert wood.keep[beyond].mean() > 0.95
    assert not wood.keep[is_blob].any()
    assert wood.report["n_floating"] >= is_blob.sum()


def test_a_sparse_top_over_a_dense_foot_is_kept():
    rng = np.random.default_rng(5)
    step = np.concatenate([np.full(1000, 0.002), 0.002 * 1.1 ** np.arange(1, 56)])
    angle = rng.uniform(0, 2 * np.pi, len(step))  # 2 mm apart at the foot, 38 cm at the top
    pole = np.column_stack([0.02 * np.cos(angle), 0.02 * np.sin(angle), np.cumsum(step)])
    wood = choose_wood(pole, np.full(len(pole), 2))
    assert wood.keep.all()


def test_sparse_strays_around_dense_wood_are_dropped():
    points, labels, _ = small_tree(0)
    strays = np.random.default_rng(6).uniform((0.5, -1.0, 0.2), (2.0, 1.0, 1.2), (40, 3))
    _, source, _ = voxel_thin(np.vstack([points, strays]), 0.008)
    label = np.concatenate([labels, np.full(40, 2)])[source]
    wood = choose_wood(np.vstack([points, strays])[source], label)
    assert not wood.keep[source >= len(points)].any()


def test_ring_gap_in_the_stem_does_not_lose_the_crown():
    points, labels, _ = small_tree(0)
    hidden = (points[:, 2] > 0.2) & (points[:, 2] < 0.38)
    _, source, _ = voxel_thin(points[~hidden], 0.008)
    wood = choose_wood(points[~hidden][source], labels[~hidden][source])
    assert wood.keep.mean() > 0.99


def test_too_little_wood_is_the_users_error():
    cloud = PointCloud(np.zeros((40, 3)), fields={"label": np.full(40, Label.TRUNK, np.uint8)})
    with pytest.raises(StageError, match="holds 40 points of the classes to contract"):
        share_cloud(cloud, GrowthOptions(), 1000)


def test_stems_stand_on_sloping_ground():
    rng = np.random.default_rng(6)
    xy = rng.uniform(-2, 2, (4000, 2))
    ground = np.column_stack([xy, 0.2 * xy[:, 0]])
    points = np.vstack([small_tree(0, (0, 0, 0))[0], small_tree(1, (1.5, 0, 0.3))[0]])
    stems = find_stems(points, ground, np.full(len(points), 2))
    assert len(stems) == 2
    assert sorted(round(stem.base[0], 1) for stem in stems) == [0.0, 1.5]
    np.testing.assert_allclose(ground_height(np.array([[1.0, 0.0]]), ground, 0.0), 0.2, atol=0.05)
    few = np.tile([0.0, 0.0, 0.3], (8, 1))
    assert ground_height(np.zeros((1, 2)), few, 1.0) == pytest.approx(0.3)
    assert ground_height(np.zeros((1, 2)), few[:7], 1.0) == 1.0, "hardly any ground is none"


@pytest.mark.parametrize("radius", [0.02, 0.12])
def test_low_branches_on_one_side_do_not_draw_the_foot_from_under_the_stem(radius):
    rng = np.random.default_rng(8)
    stem = tube((0, 0, 0), (0, 0, 1.6), radius, 20_000, rng=rng)
    low = [
        tube((0, 0, 0.08), (0.45, y, 0.05), 0.006, 20_000, rng=rng)
        for y in np.linspace(-0.25, 0.3, 12)
    ]
    points = np.vstack([stem, *low])
    foot = points[points[:, 2] < 0.08]
    assert np.linalg.norm(np.median(foot[:, :2], axis=0)) > 0.06  # they are most of it
    ground, labels = np.tile([0.0, 0.0, -0.001], (20, 1)), np.full(len(points), 2)
    (found,) = find_stems(points, ground, labels)
    assert np.linalg.norm(found.base[:2]) < max(0.03, 0.8 * radius)


def test_farthest_points_cover_and_keep_apart():
    points = np.random.default_rng(0).random((3000, 3))
    samples, nearest = farthest_point_sample(points, 0.1, first=7)
    assert samples[0] == 7 and len(np.unique(samples)) == len(samples)
    away = np.linalg.norm(points - points[samples][nearest], axis=1)
    assert away.max() <= 0.1
    apart = np.linalg.norm(points[samples][:, None] - points[samples][None], axis=2)
    assert apart[~np.eye(len(samples), dtype=bool)].min() > 0.1


def test_long_piece_is_kept_over_a_gap_that_it_does_not_point_across():
    points, labels, _ = small_tree(0)
    limb = tube((0.16, 0.0, 1.28), (0.16, 0.7, 1.30), 0.008, rng=np.random.default_rng(3))
    stray = np.array([0.0, -0.2, 1.28]) + np.random.default_rng(4).normal(0, 0.01, (60, 3))
    top = points[:, 2] < 1.15
    everything = np.vstack([points[top], limb, stray])
    kinds = np.concatenate([labels[top], np.full(len(limb) + len(stray), 2)])
    _, source, _ = voxel_thin(everything, 0.01)
    keep = choose_wood(everything[source], kinds[source], target_xy=(0, 0)).keep
    is_limb = (source >= top.sum()) & (source < top.sum() + len(limb))
    assert keep[is_limb].all()
    assert not keep[source >= top.sum() + len(limb)].any()


@pytest.mark.parametrize(("length", "is_kept"), [(0.25, True), (0.12, False)])
def test_a_piece_longer_than_its_gap_is_kept_and_a_shorter_one_is_on_record(length, is_kept):
    points, labels, _ = small_tree(0)
    aside = points[points[:, 2].argmax()] + [0.0, 0.0, 0.17]  # it points past the tree
    shoot = tube(aside, aside + [0, length, 0.0], 0.004, rng=np.random.default_rng(3))
    everything = np.vstack([points, shoot])
    _, source, _ = voxel_thin(everything, 0.008)
    label = np.concatenate([labels, np.full(len(shoot), 2)])[source]
    wood = choose_wood(everything[source], label)
    assert wood.keep[source >= len(points)].all() == is_kept
    loose = wood.report["loose"]
    assert len(loose) == (0 if is_kept else 1)
    if loose:
        assert loose[0]["gap"] == pytest.approx(0.17, abs=0.02)
        assert loose[0]["high"][1] - loose[0]["low"][1] == pytest.approx(length, abs=0.02)


def test_where_gaps_are_usual_longer_ones_are_bridged():
    """Stretches of a stem, all parted by gaps, the last by a longer one."""
    rng = np.random.default_rng(2)
    starts = np.append(np.arange(24) * 0.30, 23 * 0.30 + 0.33)
    stretches = [(0, 0, z) + rng.uniform(-0.01, 0.01, (20, 3)) for z in starts]
    points = np.vstack(stretches)
    far = choose_wood(points, np.full(len(points), 2), gap_m=0.01, stem_gap_m=0.01)
    assert far.keep.all()
    dense = np.vstack([points, (0, 0, 1.0) * rng.uniform(0, 7.0, (6000, 1))])
    kept = choose_wood(dense, np.full(len(dense), 2), gap_m=0.01, stem_gap_m=0.01).keep
    assert not kept[480:500].any()


@pytest.mark.parametrize(("size", "is_bridged"), [(3.5, True), (1.0, False)])
def test_a_cut_through_a_tall_tree_is_bridged_as_its_height_allows(size, is_bridged):
    """A scan that lacks the 50 cm between two heights, with crumbs of wood in between."""
    rng = np.random.default_rng(5)
    line = np.linspace(0, 1, 240)[:, None]
    stem = (0, 0, 1.0) * line
    limbs = np.vstack([(0, 0, 1.0) + line * way for way in ((0.3, 0, 2), (-0.3, 0.1, 2))])
    points = np.vstack([stem, limbs]) * size
    points = points[np.abs(points[:, 2] - size - 0.25) > 0.25]
    crumbs = (0.12, 0, size + 0.08) + rng.normal(0, 0.02, (12, 3))
    points = np.vstack([points, crumbs])
    wood = choose_wood(points, np.full(len(points), 2))
    assert (wood.keep[:-12].mean() > 0.95) == is_bridged


@pytest.mark.parametrize("min_density, n_kept", [(0.05, 0), (0.0, 10)])
def test_voxels_that_hold_hardly_a_point_are_no_wood(min_density, n_kept):
    rng, n = np.random.default_rng(0), 20_000
    stray = np.column_stack([np.linspace(0, 1, 10), np.full((10, 2), 0.4)])
    points = np.vstack([rng.uniform(0, [0.05, 0.05, 0.5], (n, 3)), stray])
    cloud = PointCloud(points, fields={"label": np.full(len(points), Label.BRANCH, np.uint8)})
    chosen = GrowthOptions(voxel_size_m=0.01, min_density=min_density)
    shared = share_cloud(cloud, chosen, len(points))
    assert np.count_nonzero(shared.sample >= n) == n_kept
    assert np.count_nonzero(shared.owner >= 0) > 0.99 * n
