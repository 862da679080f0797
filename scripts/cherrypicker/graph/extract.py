"""From contracted points to the rooted skeleton with radii."""

import logging

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.geometry.sampling import median_spacing
from cherrypicker.graph.line_points import axis_points
from cherrypicker.graph.prune import prune_stem_strays, prune_unseen
from cherrypicker.graph.radius import fit_radii
from cherrypicker.graph.refine import refine_skeleton, taper_skeleton
from cherrypicker.graph.regrow import regrow, surface_noise
from cherrypicker.graph.samples import auto_spacing, without_foot
from cherrypicker.graph.solver import solve_tree
from cherrypicker.graph.spanning_tree import spanning_tree

__all__ = ["extract_skeleton"]

logger = logging.getLogger(__name__)

MOST_SURFACE_POINTS = 120_000  # behind all radii but the final ones
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
    resolution = RESOLUTION_FACTOR * median_spacing(entered, cKDTree(entered, balanced_tree=False))
    spacing = max(auto_spacing(contracted.points, spacing_m), resolution)
    surface = cloud.points[np.isin(cloud["label"], np.unique(labels))]
    some = surface[:: 1 + len(surface) // MOST_SURFACE_POINTS]
    moved = np.linalg.norm(contracted.points - entered, axis=1)
    max_radius = max(3 * spacing, 1.5 * float(np.quantile(moved, 0.99)))
    radii = {"spacing": spacing, "max_radius": max_radius}
    if method == "mst":
        skeleton = spanning_tree(contracted.points, labels, spacing_m=spacing, k=k, base=base)
        skeleton = _in_frame_of(skeleton, contracted)
        return fit_radii(skeleton, surface, recentre=False, is_final=True, **radii)
    points, keep, direction = axis_points(entered, contracted.points, spacing)
    keep &= without_foot(points, entered[labels == Label.TRUNK], base)
    skeleton = solve_tree(
        points[keep],
        labels[keep],
        spacing_m=spacing,
        k=k,
        base=base,
        direction=direction[keep],
        seen=np.vstack([points, contracted.points]),
    )
    skeleton = fit_radii(_in_frame_of(skeleton, contracted), some, recentre=False, **radii)
    noise = surface_noise(skeleton)
    skeleton = prune_unseen(skeleton, entered, spacing, noise)
    skeleton = taper_skeleton(fit_radii(skeleton, some, recentre=True, **radii))
    skeleton = prune_stem_strays(skeleton, spacing, noise)
    skeleton = refine_skeleton(skeleton, entered, spacing, noise)
    skeleton = taper_skeleton(fit_radii(skeleton, some, recentre=False, **radii))
    skeleton, _ = regrow(skeleton, entered, spacing)
    skeleton = fit_radii(skeleton, some, recentre=True, **radii)
    skeleton = prune_unseen(skeleton, entered, spacing, noise)
    skeleton = prune_stem_strays(taper_skeleton(skeleton), spacing, noise)
    return taper_skeleton(fit_radii(skeleton, surface, recentre=False, is_final=True, **radii))


def _in_frame_of(skeleton, cloud):
    skeleton.unit, skeleton.frame = cloud.unit, cloud.frame
    return skeleton
