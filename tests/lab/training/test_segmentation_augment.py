"""Augmentation keeps labels with their points and does what each step says."""

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker_lab.training.segmentation import augment as aug


@pytest.fixture
def sample():
    """A flat ground with a stem and a few boughs; green ground, brown wood."""
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-2, 2, (6000, 2)), np.zeros(6000)])
    stem = rng.uniform([-0.03, -0.03, 0.05], [0.03, 0.03, 1.5], (1500, 3))
    boughs = rng.uniform([-0.8, -0.02, 1.4], [0.8, 0.02, 1.6], (1500, 3))
    labels = np.repeat([Label.GROUND, Label.TRUNK, Label.BRANCH], [6000, 1500, 1500])
    colors = np.where(labels[:, None] == Label.GROUND, [60, 120, 40], [110, 80, 60])
    trees = np.where(labels == Label.GROUND, 255, 0)
    return aug.Sample(
        np.vstack([ground, stem, boughs]).astype(np.float32),
        colors.astype(np.uint8),
        labels.astype(np.uint8),
        trees.astype(np.uint8),
    )


def test_augment_is_seeded_finite_and_consistent(sample):
    for seed in range(12):
        one = aug.augment(sample, np.random.default_rng(seed))
        two = aug.augment(sample, np.random.default_rng(seed))
        assert np.array_equal(one.points, two.points)
        assert np.isfinite(one.points).all()
        assert len(one.points) == len(one.labels) == len(one.trees) > 300
        assert set(np.unique(one.labels)) <= {0, 1, 2, 255}
        if one.colors is not None:
            assert one.colors.shape == one.points.shape
            assert one.colors.min() >= 0 and one.colors.max() <= 1


def test_isolate_leaves_the_target_tree(sample):
    alone = aug.isolate(sample.as_float(), np.random.default_rng(1), probability=1.0)
    assert (alone.labels != Label.GROUND).sum() == 3000


def test_a_branch_is_cut_free_of_trees_without_ground_alone(sample):
    sample = sample.as_float()
    assert aug.cut_free(sample, np.random.default_rng(0), probability=1.0) is sample
    tree = sample.select(sample.labels != Label.GROUND)
    pieces = [aug.cut_free(tree, np.random.default_rng(seed), 1.0) for seed in range(8)]
    size = np.array([np.ptp(piece.points, axis=0) for piece in pieces])
    assert (size.max(axis=1) < 3.0).all() and min(len(p.points) for p in pieces) < 2500
    upright = [np.linalg.svd(p.points - p.points.mean(axis=0))[2][0][2] for p in pieces]
    assert np.ptp(np.abs(upright)) > 0.3  # as they fell


def test_holes_leave_something_of_a_small_piece(sample):
    small = sample.select(np.linalg.norm(sample.points - sample.points[6000], axis=1) < 0.02)
    for seed in range(20):
        assert len(aug.punch_holes(small, np.random.default_rng(seed), n_max=30).points)


def test_move_keeps_shape_and_the_upright(sample):
    before = sample.as_float()
    after = aug.move(before, np.random.default_rng(2))
    ratio = np.linalg.norm(np.diff(after.points[:50], axis=0), axis=1) / np.linalg.norm(
        np.diff(before.points[:50], axis=0), axis=1
    )
    assert np.allclose(ratio, ratio[0]) and 0.8 <= ratio[0] <= 1.2
    stem = after.points[after.labels == Label.TRUNK]
    axis = np.linalg.svd(stem - stem.mean(axis=0))[2][0]
    assert abs(axis[2]) > np.cos(np.deg2rad(10))


def test_recolor_can_drop_all_colour(sample):
    assert aug.recolor(sample.as_float(), np.random.default_rng(0), dropout=1.0).colors is None
    assert aug.recolor(sample.as_float(), np.random.default_rng(0), dropout=0.0).colors is not None


def test_fringes_copy_wood_labels_only(sample):
    more = aug.add_fringes(sample.as_float(), np.random.default_rng(3), probability=1.0)
    added = more.labels[len(sample.labels) :]
    assert len(added) and set(np.unique(added)) <= {1, 2}


def test_floaters_are_unlabelled(sample):
    more = aug.add_floaters(sample.as_float(), np.random.default_rng(4))
    assert (more.labels[len(sample.labels) :] == Label.UNLABELLED).all()
