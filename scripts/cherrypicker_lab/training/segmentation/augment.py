"""Random changes of a labelled training cloud.

The network must hold on clouds it was not made for: photogrammetry of other cameras and light,
laser scans without colour or ground, trees of other sizes. All lengths are in metres in the tree's
frame; every function takes its random generator.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cherrypicker.classes import Label, wood_mask
from cherrypicker_lab.orchard.scene.mesh import turn_about
from cherrypicker_lab.training.segmentation.props import log_uniform


@dataclass(frozen=True)
class Sample:
    """Points (n, 3), colours (n, 3) in [0, 1] or None, labels (n,) uint8, trees (n,) of one scene.

    ``trees`` is 0 for the target tree, 1 and more for its neighbours, 255 for everything else.
    """

    points: np.ndarray
    colors: np.ndarray | None
    labels: np.ndarray
    trees: np.ndarray

    def select(self, keep):
        """Rows of a mask or an index array."""
        colors = None if self.colors is None else self.colors[keep]
        return Sample(self.points[keep], colors, self.labels[keep], self.trees[keep])

    def as_float(self):
        """Points as float64, and colours kept as uint8 as float64 in [0, 1]."""
        colors = self.colors
        if colors is not None:
            colors = colors / (255.0 if colors.dtype == np.uint8 else 1.0)
        return replace(self, points=np.asarray(self.points, np.float64), colors=colors)


def isolate(sample, rng, probability=0.2):
    """Leave the target tree alone, with or without a little ground, as in a single-tree scan."""
    if rng.random() >= probability:
        return sample
    wood = wood_mask(sample.labels) & (sample.trees == 0)
    if wood.sum() < 500:
        return sample
    keep = wood
    if rng.random() < 0.3:
        foot = sample.points[wood]
        foot = foot[foot[:, 2] < np.quantile(foot[:, 2], 0.05)].mean(axis=0)
        near = np.linalg.norm(sample.points[:, :2] - foot[:2], axis=1) < rng.uniform(0.2, 0.8)
        keep = wood | (near & (sample.labels == Label.GROUND))
    return sample.select(keep)


def cut_free(sample, rng, probability=0.4):
    """A piece of a tree without ground, as it fell: branches that were cut to be scanned."""
    if (sample.labels == Label.GROUND).any() or rng.random() >= probability:
        return sample
    centre = sample.points[rng.integers(len(sample.points))]
    near = np.linalg.norm(sample.points - centre, axis=1) < log_uniform(rng, 0.3, 1.5)
    if near.sum() < 500:
        return sample
    turn = Rotation.random(random_state=rng).as_matrix()
    piece = sample.select(near)
    return replace(piece, points=(piece.points - centre) @ turn.T)


def crop(sample, rng, probability=0.5):
    """Cut a random upright box around the scene's centre, as the region of interest would."""
    if rng.random() >= probability:
        return sample
    half = rng.uniform(0.8, 3.0, size=2)
    shift = rng.normal(0.0, 0.3, size=2)
    inside = np.all(np.abs(sample.points[:, :2] - shift) < half, axis=1)
    return sample.select(inside) if inside.sum() > 2000 else sample


def thin(sample, rng, max_points=120_000):
    """Drop points at random, unevenly over space; at most about `max_points` stay."""
    fraction = log_uniform(rng, 0.15, 1.0)
    fraction = min(fraction, max_points / max(len(sample.points), 1))
    wave = rng.normal(0.0, 1.0, 3)
    wave *= rng.uniform(0.0, 2.0) / np.linalg.norm(wave)
    density = 1.0 + 0.8 * np.sin(
        sample.points @ wave.astype(np.float32) + rng.uniform(0, 2 * np.pi)
    )
    return sample.select(rng.random(len(sample.points)) < fraction * density)


def punch_holes(sample, rng, n_max=8):
    """Remove balls of points around random places, mostly on wood: occlusions."""
    keep = np.ones(len(sample.points), bool)
    wood = np.flatnonzero(wood_mask(sample.labels))
    for _ in range(int(rng.integers(0, n_max + 1))):
        pool = wood if len(wood) and rng.random() < 0.7 else None
        center = pool[rng.integers(len(pool))] if pool is not None else rng.integers(len(keep))
        radius = log_uniform(rng, 0.03, 0.3)
        keep &= np.linalg.norm(sample.points - sample.points[center], axis=1) > radius
    return sample.select(keep) if keep.any() else sample


def add_noise(sample, rng):
    """Depth-like noise: normal, with a share of far heavier tails."""
    sigma = log_uniform(rng, 0.0005, 0.010)
    noise = rng.normal(0.0, sigma, sample.points.shape)
    tail = rng.random(len(noise)) < rng.uniform(0.0, 0.08)
    noise[tail] *= rng.uniform(2.0, 6.0)
    return replace(sample, points=sample.points + noise)


def add_fringes(sample, rng, probability=0.5):
    """Sky-coloured copies of wood points a little off the wood: silhouettes the filter left."""
    wood = np.flatnonzero(wood_mask(sample.labels))
    if sample.colors is None or not len(wood) or rng.random() >= probability:
        return sample
    chosen = rng.choice(wood, int(len(wood) * rng.uniform(0.0, 0.15)))
    sky = np.clip(np.array([0.72, 0.80, 0.90]) + rng.normal(0.0, 0.10, 3), 0.0, 1.0)
    offset = rng.normal(0.0, 0.008, (len(chosen), 3))
    share = rng.uniform(0.3, 1.0, (len(chosen), 1))
    colors = share * sky + (1 - share) * sample.colors[chosen]
    return Sample(
        np.concatenate([sample.points, sample.points[chosen] + offset]),
        np.concatenate([sample.colors, colors]),
        np.concatenate([sample.labels, sample.labels[chosen]]),
        np.concatenate([sample.trees, sample.trees[chosen]]),
    )


def add_floaters(sample, rng):
    """Isolated points in the air, unlabelled: they disturb and are not learned."""
    n = int(len(sample.points) * rng.uniform(0.0, 0.005))
    low, high = sample.points.min(axis=0), sample.points.max(axis=0)
    colors = None
    if sample.colors is not None:
        colors = np.concatenate([sample.colors, rng.random((n, 3))])
    return Sample(
        np.concatenate([sample.points, rng.uniform(low, high, (n, 3))]),
        colors,
        np.concatenate([sample.labels, np.full(n, Label.UNLABELLED, np.uint8)]),
        np.concatenate([sample.trees, np.full(n, 255, sample.trees.dtype)]),
    )


def move(sample, rng, extra_scale=1.0):
    """Turn about z, mirror, tilt a few degrees, scale by +-20 % times `extra_scale`."""
    turn = turn_about(rng.uniform(0, 2 * np.pi))
    if rng.random() < 0.5:
        turn[0] *= -1
    axis = rng.uniform(0, 2 * np.pi)
    lean = np.deg2rad(rng.normal(0.0, 2.0))
    a = np.array([np.cos(axis), np.sin(axis), 0.0])
    cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    tilt = np.eye(3) + np.sin(lean) * cross + (1 - np.cos(lean)) * cross @ cross
    scale = rng.uniform(0.8, 1.2) * extra_scale
    return replace(sample, points=scale * sample.points @ (tilt @ turn).T)


def recolor(sample, rng, dropout=0.25):
    """Exposure, contrast, gamma, white balance, saturation, grain; or no colour at all."""
    if sample.colors is None or rng.random() < dropout:
        return replace(sample, colors=None)
    colors = np.asarray(sample.colors, np.float64)
    colors = colors ** log_uniform(rng, 0.6, 1.6)
    colors = 0.5 + (colors - 0.5) * rng.uniform(0.6, 1.3)
    colors = colors * rng.uniform(0.6, 1.4) * (1.0 + rng.normal(0.0, 0.08, 3))
    gray = colors.mean(axis=1, keepdims=True)
    colors = gray + (colors - gray) * rng.choice([0.0, rng.uniform(0.3, 1.3)], p=[0.1, 0.9])
    colors = colors + rng.normal(0.0, rng.uniform(0.0, 0.06), colors.shape)
    return replace(sample, colors=colors.clip(0.0, 1.0))


def augment(sample, rng, color_dropout=0.25):
    """Apply all changes in a fixed order.

    With the probability `color_dropout` the whole cloud loses its colour.
    """
    sample = thin(sample, rng).as_float()
    alone = isolate(sample, rng)
    # A single-tree scan is often a laser scan: without colour more often than not.
    dropout = color_dropout if alone is sample else max(color_dropout, 0.7)
    # Alone, a tree's size is anybody's guess: nothing of known size stands beside it.
    extra_scale = 1.0 if alone is sample else log_uniform(rng, 0.6, 1.8)
    sample = crop(alone if alone is sample else cut_free(alone, rng), rng)
    sample = punch_holes(sample, rng)
    sample = recolor(add_fringes(sample, rng), rng, dropout)
    return add_floaters(add_noise(move(sample, rng, extra_scale), rng), rng)
