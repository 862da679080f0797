"""Neighbourhood vote, linked components, trunk islands."""

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.segmentation.refine import (
    Smoothing,
    clean_trunk,
    link_components,
    smooth_probabilities,
)


def _one_hot(labels):
    return np.eye(7, dtype=np.float32)[labels]


def test_vote_corrects_a_lone_error_and_keeps_rows_normalised():
    points = np.random.default_rng(0).random((400, 3)) * [1, 1, 0.01]
    labels = np.zeros(400, int)
    labels[7] = Label.ROOF
    smooth = smooth_probabilities(points, _one_hot(labels), Smoothing(k=8))
    assert (smooth.argmax(axis=1) == 0).all()
    assert np.allclose(smooth.sum(axis=1), 1.0)
    same = smooth_probabilities(points, _one_hot(labels), Smoothing(k=0))
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
