"""From the wood, and where the contraction put it, to the rooted skeleton with radii."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import median_spacing
from cherrypicker.graph.radius import isotonic_radii
from cherrypicker.graph.spanning_tree import FEWEST_NODES, spanning_tree
from cherrypicker.limbs.growth import Limbs, grow_limbs
from cherrypicker.limbs.joints import join_limbs
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton.axis_radii import measure_radii
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.wood.target_wood import lowest_base

__all__ = ["extract_skeleton", "limb_tree"]

# An edge with no point so near to the surface around it bridges missing data (guess)
GAP_IN_SPACINGS = 3.0


@dataclass(frozen=True)
class GraphOptions:
    """How the wood is connected; the fields are config keys of ``graph``, the first of skeleton."""

    method: str = "limbs"
    spacing_m: float = 0.01
    n_neighbors: int = 12


def extract_skeleton(
    contracted: PointCloud,
    cloud: PointCloud,
    options: GraphOptions | None = None,
    *,
    base: npt.ArrayLike | None = None,
    limbs: Limbs | None = None,
) -> Skeleton:
    """Connect and root the wood, and measure the radii.

    Parameters
    ----------
    contracted : PointCloud
        With the fields ``label`` and ``source``.
    cloud : PointCloud
        The labelled cloud that `source` points into.
    options : GraphOptions, optional
        Its method "limbs" joins the limbs of the points before they were moved
        (`cherrypicker.limbs`), "slbc" and "lbc" take the minimum spanning tree over the contracted
        points (paper, section Graph).
    base : array-like of 3 floats, optional
        Base of the stem.
    limbs : Limbs, optional
        Of those points, as the contraction grew them; left out, they are grown here.

    Returns
    -------
    Skeleton

    Raises
    ------
    StageError
        If there are too few points for a graph.
    """
    settings = options or GraphOptions()
    labels = np.asarray(contracted["label"])
    entered = cloud.points[contracted["source"]]
    surface = cloud.points[np.isin(cloud["label"], np.unique(labels))]
    spacing = settings.spacing_m
    if settings.method != "limbs":
        spacing = max(spacing, median_spacing(entered, cKDTree(entered, balanced_tree=False)))
        skeleton = spanning_tree(
            contracted.points, labels, spacing_m=spacing, k=settings.n_neighbors, base=base
        )
        widest = 1.5 * float(np.quantile(np.linalg.norm(contracted.points - entered, axis=1), 0.99))
    else:
        skeleton = limb_tree(entered, labels, spacing_m=spacing, base=base, found=limbs)
        widest = 1.5 * float(skeleton.radius.max())
    skeleton.unit, skeleton.frame = contracted.unit, contracted.frame
    told = measure_radii(
        skeleton,
        surface,
        spacing=spacing,
        max_radius=max(3 * spacing, widest),
    )
    if settings.method != "limbs":
        return told
    radius = isotonic_radii(skeleton.parent, skeleton.radius, told.fields["radius_error"])
    return replace(told, radius=radius)


def limb_tree(
    points: np.ndarray,
    labels: np.ndarray,
    *,
    spacing_m: float = 0.01,
    base: npt.ArrayLike | None = None,
    found: Limbs | None = None,
) -> Skeleton:
    """The limbs of a tree's wood, joined and labelled.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Thinned wood of one tree, z up.
    labels : ndarray of shape (n_points,), int
    spacing_m : float, default 0.01
        Longest edge along an axis.
    base : array-like of 3 floats, optional
        Base of the stem; the lowest points if left out.
    found : Limbs, optional
        The limbs, where they are known.

    Returns
    -------
    Skeleton
        With the fields ``gap`` and ``limb``.

    Raises
    ------
    StageError
        If the points make no limb, or the limbs are not theirs.
    """
    if len(points) < FEWEST_NODES:
        raise StageError(f"{len(points)} points are too few for a graph", key="graph.spacing_m")
    if found is None:
        base = lowest_base(points, labels).base if base is None else base
        found = grow_limbs(points, base, stem=labels == Label.TRUNK)
    if len(found.member) != len(points):
        raise StageError(f"limbs of {len(found.member)} points for a tree of {len(points)}")
    nodes, parent, radius, limb = join_limbs(found.limbs, found.spacing, spacing_m)
    label = _labels(nodes, parent, limb, points, labels, found.member)
    gap = _bridging(nodes, parent, radius, points, GAP_IN_SPACINGS * found.spacing)
    return Skeleton(nodes, parent, radius, label, {"gap": gap, "limb": limb})


def _labels(
    nodes: np.ndarray,
    parent: np.ndarray,
    limb: np.ndarray,
    points: np.ndarray,
    labels: np.ndarray,
    member: np.ndarray,
) -> np.ndarray:
    """Class of each node by the points of its limb: trunk from the root on, then the other."""
    label = np.full(len(nodes), int(Label.BRANCH))
    others = labels[labels != Label.TRUNK]
    rest = int(np.bincount(others).argmax()) if len(others) else int(Label.TRUNK)
    for number in np.unique(limb):
        own, rows = np.flatnonzero(limb == number), np.flatnonzero(member == number)
        up = parent[own[0]]
        label[own] = rest
        if len(rows) and (up < 0 or label[up] == Label.TRUNK):
            nearest = cKDTree(nodes[own]).query(points[rows])[1]
            votes = np.where(labels[rows] == Label.TRUNK, 1.0, -1.0)
            # the stretch from the start that holds the most trunk points more than others
            gain = np.append(0.0, np.cumsum(np.bincount(nearest, votes, len(own))))
            label[own[: int(np.argmax(gain))]] = Label.TRUNK
    return label


def _bridging(
    nodes: np.ndarray, parent: np.ndarray, radius: np.ndarray, points: np.ndarray, reach: float
) -> np.ndarray:
    """Flag of the edges to the parent around which there are no points."""
    up = np.maximum(parent, 0)
    middle = (nodes + nodes[up]) / 2
    away = cKDTree(points).query(middle)[0]
    gap = (away > np.maximum(radius, radius[up]) + reach).astype(np.int64)
    gap[0] = 0
    return gap
