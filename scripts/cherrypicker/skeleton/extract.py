"""From contracted points to the rooted skeleton with radii."""

import logging

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.skeleton.graph import auto_spacing, spanning_tree
from cherrypicker.skeleton.radius import fit_radii
from cherrypicker.skeleton.refine import (
    prune_spurs,
    refine_skeleton,
    taper_skeleton,
    trim_unsupported,
)
from cherrypicker.skeleton.sampling import median_spacing
from cherrypicker.skeleton.solver import solve_tree

__all__ = ["extract_skeleton"]

logger = logging.getLogger(__name__)

LOCAL_K = 15
LOST_FACTOR, LOST_IN_SPACINGS = 1.5, 1.5
SPARSE_FACTOR = 1.5
RESOLUTION_FACTOR = 1.3  # samples need not be closer than the points that entered the contraction


def extract_skeleton(contracted, cloud, *, method="tree", spacing_m=0.01, k=12, base=None):
    """Sample, connect and root the contracted points, and measure the radii.

    Parameters
    ----------
    contracted : PointCloud
        With the fields ``label`` and ``source``.
    cloud : PointCloud
        The labelled cloud that `source` points into.
    method : {"tree", "mst"}
    spacing_m : float, default 0.01
    k : int, default 12
    base : array-like of 3 floats, optional
        Base of the stem.

    Returns
    -------
    Skeleton

    Raises
    ------
    StageError
        If there are too few points for a graph.
    """
    labels = np.asarray(contracted["label"])
    entered = cloud.points[contracted["source"]]
    resolution = RESOLUTION_FACTOR * median_spacing(entered, cKDTree(entered))
    spacing = max(auto_spacing(contracted.points, spacing_m), resolution)
    surface = cloud.points[np.isin(cloud["label"], np.unique(labels))]
    if method == "mst":
        skeleton = spanning_tree(contracted.points, labels, spacing_m=spacing, k=k, base=base)
    else:
        # in a scan so sparse that hardly two points share a voxel, a twig is a line of points
        sparse = len(surface) < SPARSE_FACTOR * len(entered)
        lost = _lost_in_contraction(contracted.points, entered, spacing) if sparse else slice(0)
        skeleton = solve_tree(
            np.vstack([contracted.points, entered[lost]]),
            np.concatenate([labels, labels[lost]]),
            spacing_m=spacing,
            k=k,
            base=base,
            surface=entered if sparse else None,
        )
    skeleton.unit, skeleton.frame = contracted.unit, contracted.frame
    moved = np.linalg.norm(contracted.points - entered, axis=1)
    max_radius = max(3 * spacing, 1.5 * float(np.quantile(moved, 0.99)))
    radii = {"spacing": spacing, "max_radius": max_radius, "recentre": False}
    skeleton = fit_radii(skeleton, surface, **radii)
    if method == "mst":
        return skeleton
    skeleton = trim_unsupported(skeleton, spacing)
    skeleton = fit_radii(prune_spurs(skeleton, spacing), surface, **(radii | {"recentre": True}))
    skeleton = refine_skeleton(skeleton, surface, spacing)
    skeleton = fit_radii(skeleton, surface, **radii)
    return taper_skeleton(skeleton)


def _lost_in_contraction(contracted, entered, spacing):
    """Rows of points far from all that they could have contracted to.

    Points that sit in line on a thin twig contract along the twig, into clumps, or the twig slides
    into its parent. A point is explained by contracted points as near as those moved themselves
    (about a radius); the others are so thin a wood that they are skeleton points as they are.
    """
    moved = np.linalg.norm(contracted - entered, axis=1)
    tree = cKDTree(contracted)
    distance, nearest = tree.query(entered)
    _, around = tree.query(contracted, k=min(LOCAL_K, len(contracted)))
    usual = np.median(moved[around], axis=1)
    lost = np.flatnonzero(distance > LOST_FACTOR * usual[nearest] + LOST_IN_SPACINGS * spacing)
    logger.info(
        "%d of %d points lost in the contraction enter as they are", len(lost), len(entered)
    )
    return lost
