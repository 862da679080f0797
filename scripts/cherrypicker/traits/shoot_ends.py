"""Ends of a tree's shoots, how much of them a scan likely lost, and how the crown grows by that.

A scan loses the end of a shoot, and no point that it has tells by how much; but where points lie
far apart along a shoot's last stretch, more is missing than where they are dense. The loss of one
shoot is a few of these spacings: a short exponential loss for most, a long one for some. Height,
crown width and volume follow from all shoots at once, since another may reach nearly as far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from cherrypicker.geometry.error_terms import FACTORS
from cherrypicker.skeleton.model import Skeleton

# The end of a shoot, in the distance within which wood points have company (guesses): stretch of
# its direction; stretch whose points are counted, how far ahead of the tip and aside of the axis
_DIRECTION, _STRETCH, _AHEAD, _ASIDE = 2.0, 1.33, 0.13, 0.4
_ASIDE_RADII = 1.5  # as far aside where the shoot is thick


@dataclass
class ShootEnds:
    """Where shoots end in a skeleton."""

    nodes: np.ndarray  # (n_ends,) int64
    # points, directions: (n_ends, 3) float64: tips, and the way that each shoot runs there
    points: np.ndarray
    directions: np.ndarray
    # (n_ends,) float64: scale of what each has likely lost, in the skeleton's unit
    scale: np.ndarray
    beyond: float  # length that a tip may reach beyond the wood, by the noise of its points

    def select(self, rows: np.ndarray) -> ShootEnds:
        """Some of them, (n_ends,) bool."""
        nodes, points = self.nodes[rows], self.points[rows]
        return ShootEnds(nodes, points, self.directions[rows], self.scale[rows], self.beyond)


def find_shoot_ends(skeleton: Skeleton, kept: np.ndarray, wood: cKDTree, reach: float) -> ShootEnds:
    """Find the tips of a skeleton and how far apart the wood points lie there.

    Parameters
    ----------
    kept : ndarray of shape (n_nodes,), bool
        Nodes that belong to the tree.
    wood : cKDTree
        Of the wood points.
    reach : float
        Distance within which they have company.
    """
    tips = np.flatnonzero((skeleton.n_children == 0) & kept)
    tips = tips[tips > 0]
    start = _behind(skeleton, tips, _DIRECTION * reach)
    points = skeleton.points[tips]
    directions = points - skeleton.points[start]
    directions /= np.maximum(np.linalg.norm(directions, axis=1), 1e-12)[:, None]
    stretch = _STRETCH * reach
    aside = np.maximum(_ASIDE * reach, _ASIDE_RADII * skeleton.radius[tips])
    n_points = _count_along(wood, points, directions, stretch, _AHEAD * reach, aside)
    spacing = stretch / np.maximum(n_points, 1)
    scale = np.minimum(FACTORS["loss_spacings"] * spacing, FACTORS["largest_loss"] * reach)
    return ShootEnds(tips, points, directions, scale, FACTORS["tip_beyond"] * reach)


def draw_losses(ends: ShootEnds, n_samples: int, rng: np.random.Generator) -> np.ndarray:
    """Draw what shoots have lost, (n_samples, n_ends) float64; below 0 where points overshoot."""
    shape = (n_samples, len(ends.scale))
    mean = np.where(
        rng.random(shape) < FACTORS["long_share"], FACTORS["long_loss"], FACTORS["short_loss"]
    )
    return ends.scale * mean * rng.exponential(size=shape) - ends.beyond


@dataclass
class Hull:
    """Convex hull of points."""

    # (n_vertices, 3) float64: its vertices; all points where they span no volume
    points: np.ndarray
    # (360,) float64: how far it reaches horizontally, in whole degrees from +x towards +y
    reach: np.ndarray
    # normals, offsets, areas: (n_faces, 3), (n_faces,), (n_faces,) float64: of its faces; a point p
    # is `normals @ p + offsets` outside
    normals: np.ndarray
    offsets: np.ndarray
    areas: np.ndarray
    volume: float


def grow_hull(hull: Hull, ends: ShootEnds, losses: np.ndarray, overshoot: np.ndarray) -> np.ndarray:
    """Width and volume of a crown whose surface lies deeper and whose shoots reach farther.

    Parameters
    ----------
    hull : Hull
        Of the crown's points.
    losses : ndarray of shape (n_samples, n_ends), float64
        By which the shoots go on along their directions.
    overshoot : ndarray of shape (n_samples,), float64
        By which the hull lies outside the wood.

    Returns
    -------
    ndarray of shape (n_samples, 2), float64
        Width (mean of the widest horizontal extent and that across it) and volume.
    """
    ways = np.radians(np.arange(len(hull.reach)) * 360.0 / len(hull.reach))
    ways = np.vstack([np.cos(ways), np.sin(ways)])
    half = len(hull.reach) // 2
    grown = np.empty((len(losses), 2))
    for sample, (loss, over) in enumerate(zip(losses, overshoot, strict=True)):
        tips = ends.points + loss[:, None] * ends.directions
        reach = np.maximum(hull.reach - over, (tips[:, :2] @ ways).max(axis=0, initial=-np.inf))
        extent = reach[:half] + reach[half:]
        widest = int(np.argmax(extent))
        is_out = (hull.normals @ tips.T + hull.offsets[:, None]).max(axis=0, initial=-np.inf) > 0.0
        volume = hull.volume
        if is_out.any():
            volume = ConvexHull(np.vstack([hull.points, tips[is_out]])).volume
        volume -= hull.areas.sum() * over
        grown[sample] = (extent[widest] + extent[(widest + half // 2) % half]) / 2, max(volume, 0.0)
    return grown


def _behind(skeleton: Skeleton, tips: np.ndarray, reach: float) -> np.ndarray:
    """Node `reach` behind each tip, no farther than the next fork."""
    parent, length, n_children = skeleton.parent, skeleton.edge_length, skeleton.n_children
    start = tips.copy()
    for row, tip in enumerate(tips):
        node, travelled = tip, 0.0
        while parent[node] >= 0 and travelled < reach and (node == tip or n_children[node] == 1):
            travelled += length[node]
            node = parent[node]
        start[row] = node
    return start


def _count_along(
    wood: cKDTree,
    ends: np.ndarray,
    directions: np.ndarray,
    behind: float,
    ahead: float,
    aside: np.ndarray,
) -> np.ndarray:
    """Points in a tube along each end, some way behind and ahead of it and as far aside."""
    middle = ends + 0.5 * (ahead - behind) * directions
    around = wood.query_ball_point(middle, np.hypot(0.5 * (ahead + behind), aside))
    count = np.zeros(len(ends), dtype=np.int64)
    for row, near in enumerate(around):
        offset = wood.data[near] - ends[row]
        along = offset @ directions[row]
        off = (offset**2).sum(axis=1) - along**2
        count[row] = ((-behind <= along) & (along <= ahead) & (off < aside[row] ** 2)).sum()
    return count
