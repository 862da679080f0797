"""Voxel sampling and overlapping spheres, the network's view of a cloud.

The cloud is sampled on voxels, then cut into spheres of one radius with a fixed number of points
at most (paper: "a slightly modified version of spherical sub-sampling"; the choice of centres by a
potential follows KPConv, Thomas et al. 2019). A point's features are its RGB, its global xyz in the
tree's frame and its xyz normalised to the sphere.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

GLOBAL_UNIT = 3.0  # global coordinates are divided by this, so that they are of the order of 1


def in_tree_frame(points: np.ndarray, reference_height: float) -> tuple[np.ndarray, float]:
    """Points (n_points, 3), z up, in the frame that the network knows, and its scale.

    Clouds taller than the reference height are shrunk to it: the network knows trees of a few
    metres, and a 20 m tree shrunk to 6 m has the proportions of one. The lowest and highest 0.5 %
    of the points are left out of the height as possible outliers. The origin is on the ground below
    the median of what stands above the lowest tenth.
    """
    low, high = np.quantile(points[:, 2], [0.005, 0.995])
    height = high - low
    scale = 1.0 if height <= reference_height else float(reference_height / height)
    standing = points[points[:, 2] > low + 0.1 * height]
    center = np.median(standing if len(standing) else points, axis=0)
    return (points - [center[0], center[1], low]) * scale, scale


def features_of(
    points: np.ndarray, colors: np.ndarray | None, center: np.ndarray, radius: float
) -> np.ndarray:
    """Features (n, 10), float32, of the points (n, 3) of one sphere in the tree's frame.

    RGB about 0 (zeros without colour), a colour flag, global xyz, xyz normalised to the sphere;
    colours (n, 3) are in [0, 1], None for a cloud without.
    """
    features = np.zeros((len(points), 10), np.float32)
    if colors is not None:
        features[:, :3] = (colors - 0.5) * 2.0
        features[:, 3] = 1.0
    features[:, 4:7] = points / GLOBAL_UNIT
    features[:, 7:10] = (points - center) / radius
    return features


def neighbor_graphs(points: np.ndarray, k: int, n_scales: int) -> list[np.ndarray]:
    """k nearest neighbours (n, k), int32, of points (n, 3) in random order, at several scales.

    Scale s searches the first ``n / 4**s`` points, a random subset. Where it has fewer than k the
    farthest one fills the row, which a maximum over the neighbours does not see.
    """
    graphs = []
    for scale in range(n_scales):
        candidates = points[: max(len(points) // 4**scale, min(len(points), k))]
        ranks = np.arange(1, 1 + k).clip(max=len(candidates))
        graphs.append(cKDTree(candidates).query(points, k=ranks)[1].astype(np.int32))
    return graphs


def sphere_indices(
    tree: cKDTree,
    center: np.ndarray,
    radius: float,
    n_points: int,
    rng: np.random.Generator,
    visits: np.ndarray | None = None,
) -> np.ndarray:
    """Rows of one sphere's points in random order, at most `n_points`, int64.

    With `visits`, how often each point was sampled so far, the least visited ones go first.
    """
    inside = np.asarray(tree.query_ball_point(center, radius, return_sorted=True), np.int64)
    inside = rng.permutation(inside)
    if len(inside) > n_points and visits is not None:
        inside = rng.permutation(inside[np.argsort(visits[inside], kind="stable")[:n_points]])
    return inside[:n_points]


def cover(
    points: np.ndarray, radius: float, n_points: int, min_visits: int, rng: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Spheres, as centre (3,) and rows, that sample each point (n, 3) at least `min_visits` times.

    The centre of the next sphere is the point with the least potential; each sphere raises the
    potential of its points, most at its centre, so that spheres overlap evenly and a point is
    seen away from the border at least once (KPConv).
    """
    tree = cKDTree(points)
    potential = rng.uniform(0.0, 1e-3, len(points))
    visits = np.zeros(len(points), np.int32)
    while (waiting := visits < min_visits).any():
        seed = np.where(waiting, potential, np.inf).argmin()
        indices = sphere_indices(tree, points[seed], radius, n_points, rng, visits)
        if not np.any(indices == seed):
            indices[0] = seed  # others are visited less; keeps the loop finite
        distance = np.linalg.norm(points[indices] - points[seed], axis=1)
        potential[indices] += np.square(1.0 - np.square(distance / radius).clip(0, 1))
        visits[indices] += 1
        yield points[seed], indices
