"""What is dense enough to be wood, and no stray points."""

from __future__ import annotations

import logging

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["dense_enough"]

logger = logging.getLogger(__name__)


def dense_enough(
    points: np.ndarray, count: np.ndarray, size: float, min_density: float
) -> np.ndarray:
    """Which voxels hold enough points, with their neighbours, to be wood.

    Stray points of a dense reconstruction float alone; the thinnest twig that it shows still has
    a fair share of the points that thick wood has.

    Parameters
    ----------
    points : ndarray of shape (n_voxels, 3), float64
        Mean of the points of each voxel.
    count : ndarray of shape (n_voxels,), int
        Points of each voxel.
    size : float
        Edge of a voxel.
    min_density : float
        Share of the median number of points in a voxel and its neighbours.

    Returns
    -------
    ndarray of shape (n_voxels,), bool
    """
    a, b = cKDTree(points).query_pairs(1.8 * size, output_type="ndarray").T
    n = len(points)
    support = count + np.bincount(a, count[b], n) + np.bincount(b, count[a], n)
    keep = support >= min_density * np.median(support)
    logger.info(
        "kept %s of %s voxels of wood (%.1f %%), the rest too thin (under %.1f points around)",
        f"{np.count_nonzero(keep):,}",
        f"{len(keep):,}",
        100 * keep.mean(),
        min_density * np.median(support),
    )
    return keep
