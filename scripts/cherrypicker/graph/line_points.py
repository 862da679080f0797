"""Points of thin wood moved across it onto its axis: a mean shift with local directions.

A Laplacian of a few dozen neighbours spans a decimetre of a twig, and the contraction draws twigs
into one another. Where the points within a small ball form a line, its middle is the twig's axis:
every point moves there, across the line only. Thicker wood is a line only in a larger ball; what
is a line in no ball (thick stems, forks) keeps its contracted place.
"""

import numba
import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.geometry.ordering import first_not_below

__all__ = ["axis_points", "ball_means", "line_shift"]

BALLS = (2.4, 4.5, 8.0)  # radii, in spacings
ROUNDS = 3
LEAST_LINE = 0.5  # 1 - second over first eigenvalue of the points in the ball
MOST_WIDTH, NOISE_WIDTH = 0.4, 0.16  # of the ball's radius, and in spacings
FEWEST_POINTS = 4
BATCH, FAR_AWAY = 16, 1e9
EXPLAINED_WIDTHS = 1.6  # of the width of a line: where most of its points lie
NEAR_CONTRACTED, NEAR_IN_WIDTHS = 2.0, 0.6  # spacings, and widths, that the two may differ


def axis_points(points, contracted, spacing):
    """Skeleton points: the axis of thin wood where the points show it, else the contraction's.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Surface points that entered the contraction.
    contracted : ndarray of shape (n_points, 3), float64
        Where the contraction put them.
    spacing : float
        Distance of neighbouring surface points, or of the skeleton's samples.

    Returns
    -------
    skeleton_points : ndarray of shape (n_points, 3), float64
    keep : ndarray of shape (n_points,), bool
        False for points without a line of their own whose wood the lines of others explain.
    direction : ndarray of shape (n_points, 3), float64
        Of the line that each point lies on, either way; zeros where there is none.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    found = np.array(contracted, dtype=np.float64)
    around, direction = np.zeros(len(points)), np.zeros_like(found)
    waiting = np.arange(len(points))
    for ball in BALLS:
        radius = ball * spacing
        moved, line, width, count, along = line_shift(points, points[waiting], radius, ROUNDS)
        sound = (line > LEAST_LINE) & (count >= FEWEST_POINTS)
        sound &= width < MOST_WIDTH * radius + NOISE_WIDTH * spacing
        apart = contracted[waiting] - moved  # along the line the contraction may have slid
        apart -= np.einsum("ij,ij->i", apart, along)[:, None] * along
        apart = np.linalg.norm(apart, axis=1)
        sound &= apart < np.maximum(NEAR_CONTRACTED * spacing, NEAR_IN_WIDTHS * width)
        found[waiting[sound]] = moved[sound]
        around[waiting[sound]] = width[sound]
        direction[waiting[sound]] = along[sound]
        waiting = waiting[~sound]
    keep = np.ones(len(points), dtype=bool)
    lines = np.flatnonzero(around > 0)
    if len(lines) and len(waiting):
        reach = EXPLAINED_WIDTHS * np.append(around[lines], np.inf)  # the last: of none so near
        limit = 1.01 * reach[:-1].max()
        lines_tree = cKDTree(found[lines], balanced_tree=False)
        away, nearest = lines_tree.query(points[waiting], distance_upper_bound=limit)
        keep[waiting] = (away > reach[nearest]) | (nearest == len(lines))
    return found, keep, direction


def line_shift(points, places, radius, rounds):
    """Move places across the local line of the points around them, to its middle.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    places : ndarray of shape (n_places, 3), float64
    radius : float
        Of the ball of points that counts.
    rounds : int

    Returns
    -------
    places : ndarray of shape (n_places, 3), float64
    line : ndarray of shape (n_places,), float64
        1 - second over first eigenvalue of the points in the last ball: 1 is a line.
    width : ndarray of shape (n_places,), float64
        Root of the sum of the two smaller eigenvalues.
    count : ndarray of shape (n_places,), int64
        Points in the last ball.
    direction : ndarray of shape (n_places, 3), float64
        Of the line, either way.
    """
    sorted_points, key, low, shape = _in_cells(points, places, radius)
    order = np.argsort(_keys(places, low, shape, radius), kind="stable")  # neighbours in turn
    return _shift(sorted_points, key, low, shape, order, places.copy(), radius, rounds)


def ball_means(points, places, radius):
    """Mean of the points in a ball around each place; the place itself where there are none."""
    sorted_points, key, low, shape = _in_cells(points, places, radius)
    return _means(sorted_points, key, low, shape, np.asarray(places, dtype=np.float64), radius)


def _in_cells(points, places, radius):
    """Columns of the points sorted by cells of a ball's radius, their cells and the grid."""
    low = np.minimum(points.min(axis=0), places.min(axis=0)) - 2 * radius
    high = np.maximum(points.max(axis=0), places.max(axis=0)) + 2 * radius
    shape = np.ceil((high - low) / radius).astype(np.int64) + 1
    key = _keys(points, low, shape, radius)
    order = np.argsort(key, kind="stable")
    columns = np.ascontiguousarray(points[order].T, dtype=np.float64)
    return columns, key[order], low, shape


def _keys(points, low, shape, radius):
    """Number of the cell that each point lies in."""
    cell = np.floor((points - low) / radius).astype(np.int64)
    return (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]


@numba.njit(cache=True)
def _means(points, key, low, shape, places, radius):
    means = places.copy()
    near, cell = np.empty((3, BATCH)), np.full(4, -1, dtype=np.int64)
    for place in range(len(places)):
        px, py, pz = places[place, 0], places[place, 1], places[place, 2]
        near = _gather(points, key, low, shape, px, py, pz, radius, cell, near)
        n, x, y, z, _ = _ball_sums(near, cell[3], places[place], radius)
        if n:
            means[place, 0] += x
            means[place, 1] += y
            means[place, 2] += z
    return means


@numba.njit(cache=True)
def _shift(points, key, low, shape, order, places, radius, rounds):
    n_places = len(places)
    line, width = np.zeros(n_places), np.zeros(n_places)
    count = np.zeros(n_places, dtype=np.int64)
    direction = np.zeros((n_places, 3))
    near, cell = np.empty((3, BATCH)), np.full(4, -1, dtype=np.int64)
    for place in order:
        for _ in range(rounds):
            px, py, pz = places[place, 0], places[place, 1], places[place, 2]
            near = _gather(points, key, low, shape, px, py, pz, radius, cell, near)
            n, x, y, z, c = _ball_sums(near, cell[3], places[place], radius)
            count[place] = n
            if n < FEWEST_POINTS:
                break
            first, second, third = _eigenvalues(c)
            u, v, w = _eigenvector(c, first)
            along = x * u + y * v + z * w
            places[place, 0] += x - along * u
            places[place, 1] += y - along * v
            places[place, 2] += z - along * w
            direction[place, 0], direction[place, 1], direction[place, 2] = u, v, w
            line[place] = 1 - second / max(first, 1e-18)
            width[place] = np.sqrt(max(second, 0.0) + max(third, 0.0))
    return places, line, width, count, direction


@numba.njit(cache=True)
def _gather(points, key, low, shape, px, py, pz, radius, cell, near):
    """Points in the 27 cells around a place, one after the other; kept while it stays in its cell.

    `cell` holds the cell and the number of points in `near`, which far-away ones make a multiple
    of `BATCH`: what is left over from one is summed many times slower.
    """
    a = int((px - low[0]) / radius)
    b = int((py - low[1]) / radius)
    c = int((pz - low[2]) / radius)
    if a == cell[0] and b == cell[1] and c == cell[2]:
        return near
    n = 0
    for i in range(a - 1, a + 2):
        for j in range(b - 1, b + 2):
            first = (i * shape[1] + j) * shape[2] + c - 1
            row = first_not_below(key, first)
            end = row
            while end < len(key) and key[end] <= first + 2:
                end += 1
            if n + end - row + BATCH > near.shape[1]:
                larger = np.empty((3, 2 * (n + end - row + BATCH)))
                for axis in range(3):
                    for at in range(n):
                        larger[axis, at] = near[axis, at]
                near = larger
            for axis in range(3):
                for at in range(end - row):
                    near[axis, n + at] = points[axis, row + at]
            n += end - row
    padded = -(-n // BATCH) * BATCH
    for axis in range(3):
        for at in range(n, padded):
            near[axis, at] = FAR_AWAY
    cell[0], cell[1], cell[2], cell[3] = a, b, c, padded
    return near


@numba.njit(cache=True, fastmath={"reassoc", "contract", "nsz"})  # sums of several points at once
def _ball_sums(points, n_points, place, radius):
    """Number, mean offset and covariance (xx, yy, zz, xy, xz, yz) of the points in a ball."""
    limit = radius * radius
    n = sx = sy = sz = xx = yy = zz = xy = xz = yz = 0.0
    px, py, pz = place
    for row in range(n_points):
        x, y, z = points[0, row] - px, points[1, row] - py, points[2, row] - pz
        inside = 1.0 if x * x + y * y + z * z <= limit else 0.0
        n += inside
        u, v, w = inside * x, inside * y, inside * z
        sx, sy, sz = sx + u, sy + v, sz + w
        xx, yy, zz = xx + u * x, yy + v * y, zz + w * z
        xy, xz, yz = xy + u * y, xz + u * z, yz + v * z
    m = max(n, 1.0)
    sx, sy, sz = sx / m, sy / m, sz / m
    spread = (
        xx / m - sx * sx,
        yy / m - sy * sy,
        zz / m - sz * sz,
        xy / m - sx * sy,
        xz / m - sx * sz,
        yz / m - sy * sz,
    )
    return int(n), sx, sy, sz, spread


@numba.njit(cache=True)
def _eigenvalues(c):
    """Eigenvalues of a symmetric 3 x 3 matrix (xx, yy, zz, xy, xz, yz), largest first."""
    off = c[3] * c[3] + c[4] * c[4] + c[5] * c[5]
    mean = (c[0] + c[1] + c[2]) / 3
    a, b, d = c[0] - mean, c[1] - mean, c[2] - mean
    spread = np.sqrt((a * a + b * b + d * d + 2 * off) / 6)
    if spread < 1e-15:
        return mean, mean, mean
    determinant = a * (b * d - c[5] * c[5]) - c[3] * (c[3] * d - c[5] * c[4])
    determinant += c[4] * (c[3] * c[5] - b * c[4])
    angle = np.arccos(min(1.0, max(-1.0, determinant / (2 * spread**3)))) / 3
    first = mean + 2 * spread * np.cos(angle)
    third = mean + 2 * spread * np.cos(angle + 2 * np.pi / 3)
    return first, 3 * mean - first - third, third


@numba.njit(cache=True)
def _eigenvector(c, value):
    """Unit eigenvector of an eigenvalue: the longest cross product of two rows of C - value I."""
    a, b, d = c[0] - value, c[1] - value, c[2] - value
    best, x, y, z = -1.0, 0.0, 0.0, 1.0
    for pair in range(3):
        if pair == 0:
            p, q, r = c[3] * c[5] - c[4] * b, c[4] * c[3] - a * c[5], a * b - c[3] * c[3]
        elif pair == 1:
            p, q, r = c[3] * d - c[4] * c[5], c[4] * c[4] - a * d, a * c[5] - c[3] * c[4]
        else:
            p, q, r = b * d - c[5] * c[5], c[5] * c[4] - c[3] * d, c[3] * c[5] - b * c[4]
        length = p * p + q * q + r * r
        if length > best:
            best, x, y, z = length, p, q, r
    norm = np.sqrt(max(best, 1e-300))
    return x / norm, y / norm, z / norm
