"""Neighbourhood vote, linked components, trunk islands."""

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.segmentation.refine import (
    Smoothing,
    clean_trunk,
    keep_sheets,
    link_components,
    smooth_probabilities,
)


def _one_hot(labels):
    return np.eye(7, dtype=np.float32)[labels]


def test_vote_corrects_a_lone_error_and_keeps_rows_normalised():
    points = np.random.default_rng(0).random((400, 3)) * [1, 1, 0.01]
    labels = np.zeros(400, int)
    labels[7] = Label.ROOF
    smooth = smooth_probabilities(points, _one_hot(labels), Smoothing(smooth_k=8))
    assert (smooth.argmax(axis=1) == 0).all()
    assert np.allclose(smooth.sum(axis=1), 1.0)
    same = smooth_probabilities(points, _one_hot(labels), Smoothing(smooth_k=0))
    assert same[7].argmax() == Label.ROOF


def test_components_are_ordered_by_size_and_bridge_the_gap():
    z = np.concatenate([np.linspace(0, 1, 50), np.linspace(1.15, 2, 40), np.linspace(5, 6, 20)])
    points = np.column_stack([np.zeros_like(z), np.zeros_like(z), z])
    group = link_components(points, 0.2)
    assert (group[:90] == 0).all() and (group[90:] == 1).all()


def test_trunk_that_nothing_connects_to_the_ground_becomes_branch():
    rng = np.random.default_rng(1)
    ground = np.column_stack([rng.uniform(-1, 1, (800, 2)), np.full(800, 0.3)])
    stem = rng.uniform([-0.02, -0.02, 0.35], [0.02, 0.02, 1.5], (500, 3))
    island = rng.uniform([0.58, -0.02, 1.8], [0.62, 0.02, 2.2], (100, 3))
    labels = np.repeat([Label.GROUND, Label.TRUNK, Label.TRUNK], [800, 500, 100])
    result = clean_trunk(np.vstack([ground, stem, island]), _one_hot(labels), Smoothing())
    after = result.argmax(axis=1)
    assert (after[:800] == Label.GROUND).all()
    assert (after[800:1300] == Label.TRUNK).all()
    assert (after[1300:] == Label.BRANCH).all()


def test_the_largest_stem_stays_where_none_reaches_the_ground():
    rng = np.random.default_rng(2)
    stem = rng.uniform([-0.02, -0.02, 2.0], [0.02, 0.02, 3.0], (300, 3))
    result = clean_trunk(stem, _one_hot(np.full(300, int(Label.TRUNK))), Smoothing())
    assert (result.argmax(axis=1) == Label.TRUNK).all()


def test_no_trunk_is_left_alone():
    probabilities = _one_hot(np.full(20, int(Label.BRANCH)))
    assert clean_trunk(np.zeros((20, 3)), probabilities, Smoothing()) is probabilities


def _called_roof(n, second=Label.BRANCH):
    probabilities = np.zeros((n, 7), np.float32)
    probabilities[:, Label.ROOF], probabilities[:, second] = 0.6, 0.4
    return probabilities


def test_a_sloping_noisy_sheet_stays_roof_to_its_edges():
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-1.5, 1.5, 20000), rng.uniform(0, 1.2, 20000)
    sheet = np.column_stack([x, y, 3.0 - 0.4 * y + rng.normal(0, 0.01, len(x))])
    kept = keep_sheets(sheet, _called_roof(len(sheet))).argmax(axis=1) == Label.ROOF
    assert kept.mean() > 0.99


def test_a_dense_crown_and_rods_are_no_roof():
    rng = np.random.default_rng(3)
    crown = rng.uniform(-0.6, 0.6, (8000, 3)) + [0, 0, 3.0]
    rod = rng.normal(0, 0.004, (2000, 3)) + np.outer(np.linspace(0, 1.5, 2000), [0.8, 0, 0.6])
    points = np.vstack([crown, rod + [3.0, 0, 1.0]])
    after = keep_sheets(points, _called_roof(len(points)))
    assert (after.argmax(axis=1) == Label.BRANCH).mean() > 0.99
    assert np.allclose(after.sum(axis=1), 1.0)


def test_upright_posts_do_not_count_against_the_roof_that_they_carry():
    rng = np.random.default_rng(5)
    corner = rng.uniform([0, 0, 2.4], [0.6, 0.2, 2.41], (800, 3))
    posts = [rng.uniform([x, 0, 0.2], [x + 0.04, 0.04, 2.4], (1200, 3)) for x in (0, 0.28, 0.56)]
    shed = np.vstack([corner, *posts])
    kept = keep_sheets(shed, _called_roof(len(shed))).argmax(axis=1) == Label.ROOF
    assert kept[shed[:, 2] < 2.2].all()
    assert kept.mean() > 0.75  # where they meet the sheet `one_class_a_thing` decides
    bare = np.vstack(posts)
    assert (keep_sheets(bare, _called_roof(len(bare))).argmax(axis=1) == Label.BRANCH).all()


def test_what_is_not_called_roof_is_left_alone():
    points = np.random.default_rng(4).random((500, 3))
    probabilities = _one_hot(np.full(500, Label.BRANCH))
    assert keep_sheets(points, probabilities) is probabilities
