"""Points of thin wood moved across it onto its axis: a mean shift with local directions.

A Laplacian of a few dozen neighbours spans a decimetre of a twig, and the contraction draws twigs
into one another. Where the points within a small ball form a line, its middle is the twig's axis:
every point moves there, across the line only. Thicker wood is a line only in a larger ball; what
is a line in no ball (thick stems, forks) keeps its contracted place.
"""

import numba
import numpy as np
from scipy.spatial import cKDTree

__all__ = ["axis_points", "line_shift"]

BALLS = (2.4, 4.5, 8.0)  # radii, in spacings
ROUNDS = 3
LEAST_LINE = 0.5  # 1 - second over first eigenvalue of the points in the ball
MOST_WIDTH, NOISE_WIDTH = 0.4, 0.16  # of the ball's radius, and in spacings
FEWEST_POINTS = 4
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
        away, nearest = cKDTree(found[lines]).query(points[waiting])
        keep[waiting] = away > EXPLAINED_WIDTHS * around[lines[nearest]]
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
    low = np.minimum(points.min(axis=0), places.min(axis=0)) - 2 * radius
    high = np.maximum(points.max(axis=0), places.max(axis=0)) + 2 * radius
    shape = np.ceil((high - low) / radius).astype(np.int64) + 1
    cell = np.floor((points - low) / radius).astype(np.int64)
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    sorted_points = np.ascontiguousarray(points[order])
    return _shift(sorted_points, key[order], low, shape, places.copy(), radius, rounds)


@numba.njit(cache=True)
def _shift(points, key, low, shape, places, radius, rounds):
    n_places = len(places)
    line, width = np.zeros(n_places), np.zeros(n_places)
    count = np.zeros(n_places, dtype=np.int64)
    direction = np.zeros((n_places, 3))
    total, product = np.zeros(3), np.zeros(6)
    for place in range(n_places):
        for _ in range(rounds):
            total[:] = 0.0
            product[:] = 0.0
            n = _gather(points, key, low, shape, places[place], radius, total, product)
            count[place] = n
            if n < FEWEST_POINTS:
                break
            mean = total / n
            c = product / n
            c[0] -= mean[0] * mean[0]
            c[1] -= mean[1] * mean[1]
            c[2] -= mean[2] * mean[2]
            c[3] -= mean[0] * mean[1]
            c[4] -= mean[0] * mean[2]
            c[5] -= mean[1] * mean[2]
            first, second, third = _eigenvalues(c)
            x, y, z = _eigenvector(c, first)
            along = mean[0] * x + mean[1] * y + mean[2] * z
            places[place, 0] += mean[0] - along * x
            places[place, 1] += mean[1] - along * y
            places[place, 2] += mean[2] - along * z
            direction[place, 0], direction[place, 1], direction[place, 2] = x, y, z
            line[place] = 1 - second / max(first, 1e-18)
            width[place] = np.sqrt(max(second, 0.0) + max(third, 0.0))
    return places, line, width, count, direction


@numba.njit(cache=True)
def _gather(points, key, low, shape, place, radius, total, product):
    """Sums of the offsets, and of their products, of the points in a ball; their number."""
    n = 0
    a = int((place[0] - low[0]) / radius)
    b = int((place[1] - low[1]) / radius)
    c = int((place[2] - low[2]) / radius)
    for i in range(a - 1, a + 2):
        for j in range(b - 1, b + 2):
            first = (i * shape[1] + j) * shape[2] + c - 1
            row = np.searchsorted(key, first)
            while row < len(key) and key[row] <= first + 2:
                x = points[row, 0] - place[0]
                y = points[row, 1] - place[1]
                z = points[row, 2] - place[2]
                row += 1
                if x * x + y * y + z * z > radius * radius:
                    continue
                n += 1
                total[0] += x
                total[1] += y
                total[2] += z
                product[0] += x * x
                product[1] += y * y
                product[2] += z * z
                product[3] += x * y
                product[4] += x * z
                product[5] += y * z
    return n


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
