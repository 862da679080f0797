"""Shapes with a known skeleton for the skeleton's tests."""

import numpy as np

from cherrypicker.pointcloud import PointCloud

PLATE_M = 0.04  # from plate to plate of a bark with relief


def tube(start, end, radius, density=60_000, *, rng, end_radius=None, noise=0.0, relief=0.0):
    """Random points on a cone's surface, `density` a square metre; `relief` of its bark, m."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    end_radius = radius if end_radius is None else end_radius
    axis = end - start
    length = np.linalg.norm(axis)
    axis /= length
    n = max(20, int(density * 2 * np.pi * (radius + end_radius) / 2 * length))
    share, angle = rng.random(n), rng.random(n) * 2 * np.pi
    r = (
        radius + share * (end_radius - radius) + rng.normal(0, noise, n)
        if noise
        else (radius + share * (end_radius - radius))
    )
    # plates of about 2 by 2 cm
    n_plates = np.round(2 * np.pi * radius / PLATE_M)
    r += relief * np.sin(n_plates * angle) * np.sin(2 * np.pi * share * length / PLATE_M)
    u = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    around = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
    return start + share[:, None] * (end - start) + r[:, None] * around


def small_tree(seed=0, offset=(0.0, 0.0, 0.0), *, noise=0.0):
    """A 1.2 m tree: stem, four laterals, one of them with a twig; its axes as (start, end, r).

    Returns
    -------
    points, labels, axes
    """
    rng = np.random.default_rng(seed)
    axes = [
        ((0, 0, 0), (0, 0, 1.2), 0.03, 0.012, 1),
        ((0, 0, 0.5), (0.45, 0, 0.75), 0.012, 0.006, 2),
        ((0, 0, 0.65), (-0.4, 0.1, 0.95), 0.012, 0.006, 2),
        ((0, 0, 0.8), (0.05, 0.4, 1.05), 0.01, 0.006, 2),
        ((0, 0, 0.9), (0.0, -0.35, 1.2), 0.01, 0.006, 2),
        ((0.27, 0, 0.65), (0.32, 0.2, 0.85), 0.007, 0.005, 2),
    ]
    points, labels = [], []
    for start, end, radius, end_radius, label in axes:
        piece = tube(start, end, radius, end_radius=end_radius, noise=noise, rng=rng)
        points.append(piece)
        labels.append(np.full(len(piece), label))
    points, labels = np.vstack(points), np.concatenate(labels)
    inside = inside_wood(points, axes, 0.9, 3 * noise)
    return points[~inside] + np.asarray(offset), labels[~inside], axes


def old_cherry(seed=0, noise=0.003, relief=0.002):
    """A thick tree: a stem of 9 cm radius, three limbs of 5 cm, twigs on them; rough bark.

    Returns
    -------
    points, labels, axes
    """
    rng = np.random.default_rng(seed)
    axes = [
        ((0, 0, 0), (0, 0, 1.6), 0.09, 0.05),
        ((0, 0, 0.7), (0.8, 0, 1.5), 0.055, 0.02),
        ((0, 0, 0.8), (-0.7, 0.2, 1.5), 0.05, 0.02),
        ((0, 0, 0.95), (0.1, 0.7, 1.6), 0.045, 0.015),
        *(((0.4, 0, 1.1), end, 0.006, 0.003) for end in ((0.5, 0.35, 1.2), (0.45, -0.3, 1.3))),
        ((-0.35, 0.1, 1.15), (-0.45, 0.35, 1.45), 0.006, 0.003),
        ((0.05, 0.35, 1.28), (-0.2, 0.45, 1.5), 0.006, 0.003),
    ]
    pieces = [
        tube(
            start, end, r, 40_000, end_radius=tip, noise=noise, relief=relief * (r > 0.01), rng=rng
        )
        for start, end, r, tip in axes
    ]
    points = np.vstack(pieces)
    labels = np.repeat([1] + [2] * (len(axes) - 1), [len(piece) for piece in pieces])
    inside = inside_wood(points, axes, 0.93, 0.004)
    return points[~inside], labels[~inside], axes


def inside_wood(points, axes, share, margin):
    """Which points lie inside a limb: nearer to an axis than a share of its radius, by a margin."""
    inside = np.zeros(len(points), dtype=bool)
    for foot, end, radius, end_radius, *_ in axes:
        start = np.asarray(foot, float)
        step = np.asarray(end, float) - start
        way = np.clip((points - start) @ step / (step @ step), 0, 1)
        away = np.linalg.norm(points - start - way[:, None] * step, axis=1)
        inside |= away < share * (radius + way * (end_radius - radius)) - margin
    return inside


def labelled_cloud(points, labels):
    """A PointCloud in the metric frame."""
    return PointCloud(points, fields={"label": np.asarray(labels, dtype=np.uint8)}, frame="metric")


def sample_axes(axes, step=0.005):
    """Points along true axes."""
    points = []
    for foot, end, *_ in axes:
        way = np.asarray(end, float) - np.asarray(foot, float)
        n = int(np.linalg.norm(way) / step)
        points.append(foot + np.linspace(0, 1, n)[:, None] * way)
    return np.vstack(points)


def sample_skeleton(skeleton, step=0.005):
    """Points along the edges of a skeleton."""
    points = [skeleton.points]
    for node in range(1, len(skeleton)):
        a, b = skeleton.points[skeleton.parent[node]], skeleton.points[node]
        n = int(np.linalg.norm(b - a) / step)
        points.append(a + np.linspace(0, 1, n + 2)[1:-1, None] * (b - a))
    return np.vstack(points)


def stacked_least_squares(L, w_l, w_h, points):
    """Contraction by its definition: rows of W_L L stacked on W_H, solved densely (n, 3)."""
    A = np.vstack([np.diag(w_l) @ L.toarray(), np.diag(w_h)])
    b = np.vstack([np.zeros_like(points), w_h[:, None] * points])
    return np.linalg.lstsq(A, b, rcond=None)[0]
