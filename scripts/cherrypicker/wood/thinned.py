"""A cloud's wood as it is looked at: thinned to one point a voxel, without stray points."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import CLASS_NAMES, WOOD
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import majority_label, thin_to_limit
from cherrypicker.pointcloud import PointCloud

__all__ = ["FEWEST_WOOD", "GrowthOptions", "agreed_labels", "thinned_wood"]

logger = logging.getLogger(__name__)

FEWEST_WOOD = 50  # points of which a tree is looked for (guess)
N_AROUND = 13  # a point and twelve neighbours, whose most frequent class is its own (guess)
AROUND = 1.8  # in voxels: neighbours whose points count as well (all that share a face or an edge)


@dataclass(frozen=True)
class GrowthOptions:
    """Which wood limbs are grown from; the fields are config keys of ``contract``."""

    classes: tuple[int, ...] = WOOD
    voxel_size_m: float = 0.005
    gap_m: float = 0.25
    stem_gap_m: float = 0.6
    min_density: float = 0.05
    max_points: int = 100_000


def agreed_labels(points: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Class of each point: that of most points around it.

    A class is a class of a place: a lone label of the stem far out would let the wood there be
    taken for a piece of the stem.
    """
    n_points = len(points)
    around = cKDTree(points).query(points, k=min(N_AROUND, n_points))[1].reshape(n_points, -1)
    member = np.repeat(np.arange(n_points), around.shape[1])
    return majority_label(labels[around].ravel(), member, n_points)


def thinned_wood(
    cloud: PointCloud, chosen: GrowthOptions, most: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Thin the wood of a cloud.

    Stray points of a dense reconstruction float alone; the thinnest twig that it shows still has
    a fair share of the points that thick wood has.

    Parameters
    ----------
    cloud : PointCloud
        With the field ``label``.
    chosen : GrowthOptions
        A voxel stays that holds, with its neighbours, `min_density` of the median number of points
        there.
    most : int
        Voxels grow until there are no more than so many.

    Returns
    -------
    points : ndarray of shape (n, 3), float64
        Means of voxels.
    labels : ndarray of shape (n,), int64
        Most frequent class in each.
    rows, member : ndarray of int64
        Rows of the cloud that lie in them, and the voxel of each.

    Raises
    ------
    StageError
        If there is too little wood.
    """
    labels = np.asarray(cloud["label"])
    rows = np.flatnonzero(np.isin(labels, list(chosen.classes)))
    if len(rows) < FEWEST_WOOD:
        names = ", ".join(CLASS_NAMES.get(int(index), str(index)) for index in chosen.classes)
        raise StageError(
            f"the cloud holds {len(rows)} points of the classes to contract ({names})",
            key="contract.classes, segment",
        )
    points, _, member, size = thin_to_limit(cloud.points[rows], chosen.voxel_size_m, most)
    # With its neighbours a voxel of wood holds enough points
    a, b = cKDTree(points).query_pairs(AROUND * size, output_type="ndarray").T
    n, count = len(points), np.bincount(member)
    support = count + np.bincount(a, count[b], n) + np.bincount(b, count[a], n)
    least = chosen.min_density * np.median(support)
    keep = support >= least
    logger.info(
        "kept %s of %s voxels of wood (%.1f %%), the rest too thin (under %.1f points around)",
        f"{np.count_nonzero(keep):,}",
        f"{n:,}",
        100 * keep.mean(),
        least,
    )
    number = np.where(keep, np.cumsum(keep) - 1, -1)[member]
    rows, member = rows[number >= 0], number[number >= 0]
    points = points[keep]
    return points, majority_label(labels[rows], member, len(points)), rows, member
