"""Nodes of a graph: skeleton points sampled evenly, the root at the foot of the stem first."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import farthest_point_sample, majority_label
from cherrypicker.wood.feet import lowest_thick

__all__ = [
    "FEWEST_NODES",
    "auto_spacing",
    "find_root",
    "lowest_wood",
    "sample_nodes",
]

FEWEST_NODES = 3
MOST_SAMPLES = 20_000
THICK_SHARE, MOSTLY_TRUNK = 0.02, 0.5  # around the foot, that its label may be believed
FOOT_SHARE = 0.05  # of the height: how far above its lowest point the stem's foot is looked for


def auto_spacing(points: np.ndarray, spacing_m: float) -> float:
    """Sampling distance: what is asked for, or more where that gives too many samples."""
    extent = float(np.ptp(points, axis=0).max())
    if extent <= 0:
        raise StageError("all contracted points coincide", key="contract.preset")
    return max(spacing_m, extent / MOST_SAMPLES)


def find_root(points: np.ndarray, labels: np.ndarray, base: npt.ArrayLike | None = None) -> int:
    """Row of the point that the tree is rooted in: the foot of the stem.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3)
        Skeleton points, z up.
    labels : ndarray of shape (n_points,), int
    base : array-like of 3 floats, optional
        Where the stem stands; among the low points the nearest to its x/y is taken.

    Returns
    -------
    int
        The lowest trunk point; where the wood around it is no trunk, the lowest thick wood.
    """
    rows = np.flatnonzero(labels == Label.TRUNK)
    height = float(np.ptp(points[:, 2])) or 1.0
    if len(rows):
        if base is not None:
            aside = np.linalg.norm(points[rows, :2] - np.asarray(base)[:2], axis=1)
            rows = rows[aside <= max(3 * aside.min(), FOOT_SHARE * height)]
        root = int(rows[np.argmin(points[rows, 2])])
        around = np.linalg.norm(points - points[root], axis=1) < THICK_SHARE * height
        if np.mean(labels[around] == Label.TRUNK) >= MOSTLY_TRUNK:
            return root
    return lowest_wood(points, base)


def lowest_wood(points: np.ndarray, base: npt.ArrayLike | None = None) -> int:
    """Row of the lowest point of thick wood, near `base` where that is given."""
    height = float(np.ptp(points[:, 2])) or 1.0
    return lowest_thick(points, THICK_SHARE * height, 2 * FOOT_SHARE * height, base)


def sample_nodes(
    points: np.ndarray, labels: np.ndarray, spacing_m: float, base: npt.ArrayLike | None = None
) -> tuple[np.ndarray, np.ndarray, float]:
    """Sample skeleton points evenly, the root first.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    labels : ndarray of shape (n_points,), int
    spacing_m : float
        Every point lies within this distance of a sample, or more in a large tree.
    base : array-like of 3 floats, optional
        See `find_root`.

    Returns
    -------
    samples : ndarray of shape (n_samples,), int64
        Rows of `points`.
    label : ndarray of shape (n_samples,), int64
        Most frequent class around each sample.
    spacing : float

    Raises
    ------
    StageError
        If there are too few points or they coincide.
    """
    spacing = auto_spacing(points, spacing_m)
    first = find_root(points, labels, base)
    samples, nearest = farthest_point_sample(points, spacing, first=first)
    if len(samples) < FEWEST_NODES:
        raise StageError(
            f"{len(samples)} skeleton samples are too few for a graph", key="graph.spacing_m"
        )
    return samples, majority_label(labels, nearest, len(samples)), spacing
