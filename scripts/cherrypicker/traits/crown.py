"""Height and crown of a tree from its wood points, with bootstrap samples of each.

Extremes of a cloud (its top, its hull) can only shrink when points are drawn again, so the
bootstrap is smoothed: a drawn point moves by the local point spacing, the scale on which the
surface is known.
"""

from dataclasses import dataclass

import numba
import numpy as np
from scipy.spatial import ConvexHull, Delaunay, QhullError, cKDTree

__all__ = [
    "Crown",
    "alpha_volume",
    "crown_of",
    "horizontal_width",
    "measure_crown",
    "projected_area",
    "robust_top",
]

_TOP_RANK = 3  # the top is this point from above: two stray points do not make a tree taller
_MAX_POINTS = 20_000
_LAG_RANK = 21
_N_UPPER = 500
_LOST_WIDTH, _NOISY_WIDTH = 0.35, 0.2  # of the four sides' summed lags; measured, docs/traits.md
_N_DIRECTIONS, _N_OUTERMOST = 128, 12  # points in each direction can decide the crown's extent
_WAYS = np.vstack([np.cos(np.radians(np.arange(180.0))), np.sin(np.radians(np.arange(180.0)))])
_LAG_SHARE = 0.4  # of the drop from the third to the 21st highest point; measured, docs/traits.md


@dataclass
class Crown:
    """Extent of a tree's wood, in the cloud's unit.

    Attributes
    ----------
    top : float
        z of the highest wood.
    width : float
        Mean of the widest horizontal extent of the crown and the extent across it.
    volume : float
        Volume of the crown's convex hull.
    """

    top: float
    width: float
    volume: float


def robust_top(z):
    """z of the third highest point (of the highest with fewer points)."""
    rank = min(_TOP_RANK, len(z))
    return float(np.partition(z, len(z) - rank)[len(z) - rank])


def crown_of(skeleton, axis_owner, wood, support):
    """Wood points of the crown: everything but the trunk below its first junction.

    Parameters
    ----------
    skeleton : Skeleton
    axis_owner : ndarray of shape (n_nodes,), int64
        Axis of each node, 0 is the trunk.
    wood : ndarray of shape (n_wood, 3), float64
    support : Support
        Of these points.

    Returns
    -------
    ndarray of shape (n_wood,), bool
        None set where the tree has no junction.
    """
    junctions = np.flatnonzero((skeleton.n_children > 1) & (axis_owner == 0))
    if not len(junctions):
        return np.zeros(len(wood), dtype=bool)
    is_clear_stem = np.zeros(len(skeleton), dtype=bool)
    node = junctions.min()  # parents come before children: the lowest along the trunk
    while node >= 0:
        is_clear_stem[node] = True
        node = skeleton.parent[node]
    # Only points beside the clear stem can have one of its nodes as the nearest.
    stem, away = skeleton.points[is_clear_stem], support.farthest + skeleton.edge_length.max() / 2
    beside = support.point & (wood >= stem.min(axis=0) - away).all(axis=1)
    beside = np.flatnonzero(beside & (wood <= stem.max(axis=0) + away).all(axis=1))
    _, nearest = cKDTree(skeleton.points).query(wood[beside])
    in_crown = support.point.copy()
    in_crown[beside] = ~is_clear_stem[nearest]
    return in_crown


def measure_crown(tree_points, crown_points, *, n_bootstrap, rng):
    """Measure top, crown width and volume, and the same of resampled points.

    Parameters
    ----------
    tree_points : ndarray of shape (n, 3), float64
        Supported wood points of the whole tree.
    crown_points : ndarray of shape (m, 3), float64
        Those of the crown; may be empty.
    n_bootstrap : int
    rng : numpy.random.Generator

    Returns
    -------
    crown : Crown
    samples : ndarray of shape (n_bootstrap, 3), float64
        Top, width and volume of each bootstrap sample. The top's are drawn upwards and the
        width's outwards as well, for the ends of shoots that a scan loses.
    """
    directions = rng.standard_normal((_N_DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    crown = Crown(robust_top(tree_points[:, 2]), *_extent(crown_points))
    top_points = _upper(tree_points)
    shell = _thin(crown_points, directions)
    top_spacing, shell_spacing = _spacing(top_points), _spacing(shell)
    samples = np.empty((n_bootstrap, 3))
    for i in range(n_bootstrap):
        drawn = rng.integers(0, len(top_points), len(top_points))
        z = top_points[drawn, 2] + top_spacing[drawn] * rng.standard_normal(len(drawn)) / 2
        samples[i, 0] = robust_top(z)
        if len(shell):
            drawn = rng.integers(0, len(shell), len(shell))
            jitter = shell_spacing[drawn, None] * rng.standard_normal((len(drawn), 3)) / 2
            samples[i, 1:] = _extent(shell[drawn] + jitter, directions)
        else:
            samples[i, 1:] = 0.0
    # Of a sample only the outermost point of each direction counts; the bias is taken off.
    for column, value in enumerate((crown.top, crown.width, crown.volume)):
        samples[:, column] += value - np.median(samples[:, column])
    samples[:, 0] += _unseen_tip(tree_points[:, 2]) * rng.exponential(size=n_bootstrap)
    if len(crown_points):
        samples[:, 1] += _unseen_width(crown_points[:, :2], n_bootstrap, rng)
    return crown, samples


def _unseen_tip(z):
    """Mean length of the tip above the highest points, from how the points thin out below it.

    A scan loses the end of a shoot, and no point that it has tells by how much. Where the points
    thin out over a long way to the top, more is missing than where they end at once.
    """
    n_below = min(_LAG_RANK, len(z))
    below = np.partition(z, len(z) - n_below)[len(z) - n_below]
    return _LAG_SHARE * max(robust_top(z) - float(below), 0.0)


def _unseen_width(flat, n_samples, rng):
    """Draw (n_samples,) what unseen ends on the crown's four sides add to its width.

    A side ends in several shoots that reach nearly as far, so that the loss of one shortens it by
    less; the outermost points are the noisiest, which errs either way.
    """
    along, across = _widest_and_across(flat)
    lags = sum(_unseen_tip(sign * flat @ way) for way in (along, across) for sign in (1, -1))
    unseen = _LOST_WIDTH * rng.exponential(size=n_samples)
    return lags * (unseen + _NOISY_WIDTH * rng.standard_normal(n_samples))


def _upper(points):
    """Points that can become the top: the highest."""
    if len(points) > _N_UPPER:
        points = points[points[:, 2] >= np.partition(points[:, 2], -_N_UPPER)[-_N_UPPER]]
    return points[np.argsort(-points[:, 2], kind="stable")[:_N_UPPER]]


def _thin(points, directions):
    """Points near the convex hull in many directions: what decides width and volume."""
    if len(points) < 200:
        return points
    rows = _outermost(np.ascontiguousarray(points), directions, _N_OUTERMOST)
    return points[np.unique(rows)]


@numba.njit(cache=True)
def _outermost(points, directions, n):
    """Rows of the `n` points that reach farthest in each direction, (n_directions, n)."""
    rows = np.empty((len(directions), n), dtype=np.int64)
    reach = np.empty(n)
    for number in range(len(directions)):
        x, y, z = directions[number]
        filled = 0
        for row in range(len(points)):
            far = points[row, 0] * x + points[row, 1] * y + points[row, 2] * z
            if filled == n and far <= reach[n - 1]:
                continue
            at = min(filled, n - 1)
            while at > 0 and reach[at - 1] < far:
                reach[at], rows[number, at] = reach[at - 1], rows[number, at - 1]
                at -= 1
            reach[at], rows[number, at] = far, row
            filled = min(filled + 1, n)
    return rows


def _spacing(points):
    if len(points) < 2:
        return np.zeros(len(points))
    distance = cKDTree(points).query(points, k=2)[0][:, 1]
    return np.minimum(distance, 3 * np.median(distance))


def _extent(points, directions=None):
    """Width and convex volume; zeros where the points span no volume.

    With directions, (n, 3), only of the outermost point in each.
    """
    if directions is not None and len(points) > len(directions):
        points = points[np.unique(_outermost(points, directions, 1))]
    if len(points) < 4:
        return 0.0, 0.0
    try:
        hull = ConvexHull(points)
    except QhullError:
        return horizontal_width(points[:, :2]), 0.0
    return horizontal_width(points[hull.vertices, :2]), float(hull.volume)


def horizontal_width(flat):
    """Mean of the widest extent of flat points (n, 2) and the extent at right angles to it."""
    return float(np.mean([np.ptp(flat @ way) for way in _widest_and_across(flat)]))


def _widest_and_across(flat):
    """Unit direction of the widest extent, to whole degrees, and the one at right angles to it."""
    extent = _extents(np.ascontiguousarray(flat, dtype=np.float64), *_WAYS)
    way = _WAYS[:, np.argmax(extent)]
    return way, np.array([-way[1], way[0]])


@numba.njit(cache=True)
def _extents(flat, x, y):
    """Extent of flat points in each of several directions."""
    extent = np.empty(len(x))
    for way in range(len(x)):
        low, high = np.inf, -np.inf
        for row in range(len(flat)):
            along = flat[row, 0] * x[way] + flat[row, 1] * y[way]
            low, high = min(low, along), max(high, along)
        extent[way] = high - low
    return extent


def projected_area(points):
    """Area of the convex hull of points seen from above; 0 where they span none."""
    if len(points) < 3:
        return 0.0
    try:
        return float(ConvexHull(points[:, :2]).volume)
    except QhullError:
        return 0.0


def alpha_volume(points, alpha, cell):
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
    cells = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    shape = cells.max(axis=0) + 1
    key = (cells[:, 0] * shape[1] + cells[:, 1]) * shape[2] + cells[:, 2]
    points = points[np.unique(key, return_index=True)[1]]
    if len(points) < 4:
        return 0.0
    try:
        corners = points[Delaunay(points).simplices]
    except QhullError:
        return 0.0
    edges = corners[:, 1:] - corners[:, :1]
    determinant = np.linalg.det(edges)
    solid = np.abs(determinant) > 1e-12 * np.abs(edges).max() ** 3
    edges, determinant = edges[solid], determinant[solid]
    centre = np.linalg.solve(2 * edges, (edges**2).sum(axis=2)[..., None])[..., 0]
    small = np.linalg.norm(centre, axis=1) <= alpha
    return float(np.abs(determinant[small]).sum() / 6)
