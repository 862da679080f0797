"""Hulls of points: convex ones, how far they reach sideways, and alpha shapes."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, Delaunay, QhullError

from cherrypicker.geometry.sampling import voxel_keys

_TURN = np.radians(np.arange(360.0))
_WAYS = np.vstack([np.cos(_TURN), np.sin(_TURN)])  # horizontal, in whole degrees from +x towards +y


@dataclass
class Hull:
    """Convex hull of points."""

    points: np.ndarray  # (n_vertices, 3) float64: its vertices; all where they span no volume
    # (n_faces, 4) float64: a point lies `equations @ [x, y, z, 1]` outside a face
    equations: np.ndarray
    area: float
    volume: float


def hull_of(points: np.ndarray) -> Hull:
    """The :class:`Hull` of points, (n, 3) float64."""
    try:
        hull = ConvexHull(points) if len(points) > 3 else None
    except QhullError:
        hull = None
    if hull is None:
        return Hull(points, np.empty((0, points.shape[1] + 1)), 0.0, 0.0)
    return Hull(points[hull.vertices], hull.equations, float(hull.area), float(hull.volume))


def reach_around(flat: np.ndarray) -> np.ndarray:
    """How far flat points (n, 2) reach in each whole degree, (360,) float64."""
    return (flat @ _WAYS).max(axis=0, initial=-np.inf)


def width_of(reach: np.ndarray) -> float:
    """Mean of the widest extent of what reaches so far, (360,), and of that across it."""
    extent = reach[:180] + reach[180:]
    widest = np.argmax(extent)
    return float(extent[widest] + extent[(widest + 90) % 180]) / 2


def alpha_volume(points: np.ndarray, alpha: float, cell: float) -> float:
    """Volume of the alpha shape of points (n, 3), float64; 0 where they span none.

    It is that of the tetrahedra of their Delaunay mesh with a circumsphere of at most a radius of
    `alpha`: hollows wider than this are no crown. Points are thinned to one a cell first.
    """
    if len(points) < 4:
        return 0.0
    points = points[np.unique(voxel_keys(points, cell), return_index=True)[1]]
    try:
        corners = points[Delaunay(points).simplices]
    except QhullError:
        return 0.0
    edges = corners[:, 1:] - corners[:, :1]
    determinant = np.linalg.det(edges)
    edges, determinant = edges[determinant != 0], determinant[determinant != 0]
    centre = np.linalg.solve(2 * edges, (edges**2).sum(axis=2)[..., None])[..., 0]
    small = np.linalg.norm(centre, axis=1) <= alpha
    return float(np.abs(determinant[small]).sum() / 6)
