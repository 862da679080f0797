"""Dominant sky colours."""

import numpy as np
import pytest

from cherrypicker.errors import StageError
from cherrypicker.sky import colors
from cherrypicker.sky.colors import (
    cluster_sky_colors,
    read_sky_colors,
    sample_sky_pixels,
    write_sky_colors,
)


def two_skies():
    """700 clear and 300 overcast samples, and 10 of nothing in particular."""
    rng = np.random.default_rng(0)
    clear = rng.normal((90, 140, 210), 3, (7000, 3))
    grey = rng.normal((225, 228, 232), 2, (3000, 3))
    odd = rng.uniform(0, 80, (30, 3))
    return np.clip(np.vstack([clear, grey, odd]), 0, 255).astype(np.uint8)


def test_two_skies_are_two_clusters_largest_first():
    sky = cluster_sky_colors(two_skies(), seed=0)
    assert sky.n_clusters == 2
    assert sky.fraction == pytest.approx([0.7, 0.3], abs=0.02)
    first = sky.colors[sky.cluster == 0].mean(axis=0) * 255
    assert first == pytest.approx([90, 140, 210], abs=4)
    assert ((sky.colors >= 0) & (sky.colors <= 1)).all()


def test_distance_tells_sky_from_bark():
    sky = cluster_sky_colors(two_skies(), seed=0)
    distance = sky.distance(np.array([[90, 140, 210], [225, 228, 232], [70, 60, 50]]) / 255.0)
    assert distance[0] < 0.02 and distance[1] < 0.02 and distance[2] > 0.3


def test_a_scan_without_sky_has_no_clusters(tmp_path):
    sky = cluster_sky_colors(np.zeros((0, 3), np.uint8), seed=0)
    assert sky.n_clusters == 0 and np.isinf(sky.distance(np.zeros((4, 3)))).all()
    write_sky_colors(tmp_path / "c.npz", sky)
    assert read_sky_colors(tmp_path / "c.npz").n_clusters == 0


def test_a_white_sky_is_one_cluster():
    sky = cluster_sky_colors(np.full((20000, 3), 255, np.uint8), seed=0)
    assert sky.n_clusters == 1 and sky.fraction[0] > 0.95


def test_equal_seeds_give_equal_bytes(tmp_path):
    for name in ("a", "b"):
        write_sky_colors(tmp_path / name, cluster_sky_colors(two_skies(), seed=0))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_samples_keep_off_the_border_of_the_mask():
    image = np.zeros((50, 60, 3), np.uint8)
    image[:20] = 200
    image[19] = 100
    mask = np.zeros((50, 60), np.uint8)
    mask[:20] = 255
    samples = sample_sky_pixels(image, mask, 10_000, np.random.default_rng(0))
    assert len(samples) == 19 * 60 and (samples == 200).all()
    assert len(sample_sky_pixels(image, mask, 7, np.random.default_rng(0))) == 7


def test_a_broken_file_is_named(tmp_path):
    np.savez(
        tmp_path / "c.npz",
        colors=np.zeros((2, 4)),
        cluster=np.zeros(2),
        fraction=[1.0],
        n_sampled=2,
    )
    with pytest.raises(StageError, match=r"c\.npz"):
        read_sky_colors(tmp_path / "c.npz")


def test_a_rare_colour_is_no_sky(monkeypatch):
    """A red roof that the masks took for sky: as dense as a sky's colour, and a hundredth of it."""
    roof = np.clip(np.random.default_rng(1).normal((170, 60, 50), 2, (100, 3)), 0, 255)
    samples = np.vstack([two_skies(), roof.astype(np.uint8)])
    sky = cluster_sky_colors(samples, seed=0)
    assert sky.n_clusters == 2 and sky.distance(np.array([[170, 60, 50]]) / 255.0)[0] > 0.3
    monkeypatch.setattr(colors, "LEAST_SHARE", 0.005)
    kept = cluster_sky_colors(samples, seed=0)
    assert kept.n_clusters == 3
