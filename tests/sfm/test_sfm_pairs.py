"""Which photos are matched with which."""

import numpy as np

from cherrypicker.sfm import pairs as paired
from cherrypicker.sfm.pairs import global_descriptors, retrieval_pairs, sequential_pairs


def test_sequential_pairs_close_the_ring(monkeypatch):
    assert sequential_pairs(3) == {(0, 1), (0, 2), (1, 2)}, "no pair twice, none with itself"
    monkeypatch.setattr(paired, "N_PARTNERS", 2)
    pairs = sequential_pairs(20)
    assert {(0, 1), (0, 2), (0, 19), (1, 19)} <= pairs
    assert {(0, 4), (0, 8), (0, 16)} <= pairs, "quadratic overlap"
    assert (0, 5) not in pairs


def ring_descriptors(n_photos, rng, n_visible=300, n_features=2000):
    """Descriptors of photos of a ring, each of which sees a window of the ring's features."""
    scene = rng.gamma(0.6, 40.0, (n_features, 128))
    step = n_features // n_photos
    for i in range(n_photos):
        seen = scene[np.arange(i * step, i * step + n_visible) % n_features]
        yield np.clip(seen + rng.normal(0, 4, seen.shape), 0, 255).astype(np.uint8)


def test_retrieval_finds_the_neighbours_on_a_ring(monkeypatch):
    descriptors = list(ring_descriptors(20, np.random.default_rng(1)))
    vectors = global_descriptors(descriptors, seed=3)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, rtol=1e-5)
    monkeypatch.setattr(paired, "N_ALIKE", 4)
    pairs = retrieval_pairs(descriptors, seed=3)
    assert np.mean([min(j - i, 20 - j + i) <= 2 for i, j in pairs]) > 0.85
    assert {(0, 1), (0, 19)} <= pairs


def test_a_photo_without_features_is_like_none():
    none = np.empty((0, 128), np.uint8), np.empty((0, 0), np.uint8)  # blank, and never described
    vectors = global_descriptors([*ring_descriptors(5, np.random.default_rng(1)), *none])
    assert not vectors[-2:].any()
    assert np.isfinite(vectors).all()


def test_equal_seed_gives_equal_descriptors():
    descriptors = list(ring_descriptors(6, np.random.default_rng(1)))
    first, second = (global_descriptors(descriptors, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first, second)
