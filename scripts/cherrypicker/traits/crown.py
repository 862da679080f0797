"""Height and crown of a tree from its wood points, with samples of each.

Both reach as far as the points do, less what noise carries beyond the wood, plus what the scan
lost of the shoots that end there, see `cherrypicker.traits.shoot_ends`. The estimates are the
medians of the samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, Delaunay, QhullError

from cherrypicker.geometry.error_terms import FACTORS
from cherrypicker.geometry.sampling import voxel_keys
from cherrypicker.traits.shoot_ends import Hull, ShootEnds, draw_losses, grow_hull

_N_RADIALS, _N_LEVELS = 8, 5  # of the contour (Culver and Till 1967)
_TOP_RANK = 3  # the top is this point from above: two stray points do not make a tree taller
_FLAT = 1e-12  # of a tetrahedron's largest edge cubed: one of less volume has no circumsphere
_WAYS = np.vstack([np.cos(np.radians(np.arange(360.0))), np.sin(np.radians(np.arange(360.0)))])


@dataclass
class Crown:
    """Extent of a tree's wood, in the cloud's unit."""

    top: float  # z of the highest wood
    width: float  # mean of the widest horizontal extent of the crown and the extent across it
    volume: float  # volume of the crown's convex hull


def hull_of(points: np.ndarray) -> Hull:
    """The :class:`Hull` of points, (n, 3) float64 with n of 1 at least."""
    try:
        hull = ConvexHull(points) if len(points) > 3 else None
    except QhullError:
        hull = None
    if hull is None:
        none = np.zeros(0)
        reach = (points[:, :2] @ _WAYS).max(axis=0)
        return Hull(points, reach, np.zeros((0, 3)), none, none, 0.0)
    corners, vertices = points[hull.simplices], points[hull.vertices]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return Hull(
        vertices,
        (vertices[:, :2] @ _WAYS).max(axis=0),
        np.ascontiguousarray(hull.equations[:, :3]),
        np.ascontiguousarray(hull.equations[:, 3]),
        np.linalg.norm(across, axis=1) / 2,
        float(hull.volume),
    )


def robust_top(z: np.ndarray) -> float:
    """z of the third highest point (of the highest with fewer points)."""
    rank = min(_TOP_RANK, len(z))
    return float(np.partition(z, len(z) - rank)[len(z) - rank])


def measure_crown(
    tree_points: np.ndarray,
    hull: Hull | None,
    ends: ShootEnds,
    scatter: float,
    reach: float,
    *,
    in_crown: np.ndarray | None = None,
    n_samples: int,
    rng: np.random.Generator,
) -> tuple[Crown, np.ndarray]:
    """Measure top, crown width and volume, and how sure they are.

    Parameters
    ----------
    tree_points : ndarray of shape (n, 3), float64
        Supported wood points of the whole tree.
    hull : Hull or None
        Of the crown's points; None without a crown.
    scatter : float
        Of the points around the skeleton's radii; 0 where it is not known.
    reach : float
        Distance within which wood points have company.
    in_crown : ndarray of shape (n_nodes,), bool, optional
        Nodes of the crown, all without it: the others' ends do not widen it.
    n_samples : int
        With 0 the points' own extent is taken.

    Returns
    -------
    crown : Crown
    samples : ndarray of shape (n_samples, 3), float64
        Top, width and volume of each sample.
    """
    plain = Crown(robust_top(tree_points[:, 2]), 0.0, 0.0)
    if hull is not None:
        plain.width, plain.volume = horizontal_width(hull.points[:, :2]), hull.volume
    if n_samples == 0:
        return plain, np.zeros((0, 3))
    losses = draw_losses(ends, n_samples, rng)
    spread = FACTORS["overshoot_spread"] * rng.standard_normal(n_samples)
    over = scatter * (FACTORS["overshoot"] + spread)
    tops = np.full((n_samples, 1), plain.top)
    grown = ends.points[:, 2] + losses * ends.directions[:, 2]
    samples = np.zeros((n_samples, 3))
    samples[:, 0] = np.hstack([tops, grown]).max(axis=1)
    if hull is not None:
        own = np.ones(len(ends.nodes), dtype=bool) if in_crown is None else in_crown[ends.nodes]
        samples[:, 1:] = grow_hull(hull, ends.select(own), losses[:, own], over)
    return Crown(*(float(value) for value in np.median(samples, axis=0))), samples


def horizontal_width(flat: np.ndarray) -> float:
    """Mean of the widest extent of flat points (n, 2), to whole degrees, and that across it."""
    extent = np.ptp(flat @ _WAYS[:, :180], axis=0)
    widest = np.argmax(extent)
    return float(extent[widest] + extent[(widest + 90) % 180]) / 2


def projected_area(points: np.ndarray) -> float:
    """Area of the convex hull of points seen from above; 0 where they span none."""
    if len(points) < 3:
        return 0.0
    try:
        return float(ConvexHull(points[:, :2]).volume)
    except QhullError:
        return 0.0


def alpha_volume(points: np.ndarray, alpha: float, cell: float) -> float:
    """Volume of the alpha shape of points: tetrahedra of their Delaunay mesh that are small.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
    alpha : float
        Largest radius of a tetrahedron's circumsphere: hollows wider than this are no crown.
    cell : float
        Points are thinned to one a cube of this side first.

    Returns
    -------
    float
        0 where the points span no volume.
    """
    if len(points) < 4:
        return 0.0
    points = points[np.unique(voxel_keys(points, cell), return_index=True)[1]]
    if len(points) < 4:
        return 0.0
    try:
        corners = points[Delaunay(points).simplices]
    except QhullError:
        return 0.0
    edges = corners[:, 1:] - corners[:, :1]
    determinant = np.linalg.det(edges)
    solid = np.abs(determinant) > _FLAT * np.abs(edges).max() ** 3
    edges, determinant = edges[solid], determinant[solid]
    centre = np.linalg.solve(2 * edges, (edges**2).sum(axis=2)[..., None])[..., 0]
    small = np.linalg.norm(centre, axis=1) <= alpha
    return float(np.abs(determinant[small]).sum() / 6)


def contour_volume(points: np.ndarray, middle: np.ndarray) -> float:
    """Volume within a crown's outline: eight radials from the stem at each of five levels.

    Culver and Till (Australian Journal of Experimental Agriculture and Animal Husbandry 7:587-592,
    1967) measured five widths of the profile on each of eight radials and found no form needed.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
        Of the crown.
    middle : ndarray of shape (2,)
        x and y of the stem.

    Returns
    -------
    float
        Sum over the levels of the areas of eight sectors, each as wide as the farthest point in it,
        times a level's height; 0 without points.
    """
    if not len(points):
        return 0.0
    low, depth = points[:, 2].min(), np.ptp(points[:, 2])
    level = ((points[:, 2] - low) / max(depth, 1e-12) * _N_LEVELS).astype(int)
    level = np.minimum(level, _N_LEVELS - 1)
    x, y = (points[:, :2] - middle).T
    radial = np.floor((np.arctan2(y, x) / (2 * np.pi) + 0.5) * _N_RADIALS).astype(int)
    widest = np.zeros((_N_LEVELS, _N_RADIALS))
    np.maximum.at(widest, (level, radial % _N_RADIALS), x**2 + y**2)
    return float(np.pi / _N_RADIALS * widest.sum() * depth / _N_LEVELS)
