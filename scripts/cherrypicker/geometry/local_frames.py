"""What each point's neighbourhood looks like: its axis, normal and thickness (compiled)."""

import numba
import numpy as np

__all__ = ["eigenvalue", "eigenvector", "neighborhood_axes", "neighborhood_spread"]

TINY = 1e-300


@numba.njit(cache=True, inline="always")
def eigenvalue(xx, yy, zz, xy, xz, yz, largest):
    """Largest (or else smallest) eigenvalue of a symmetric 3 x 3 matrix, by the closed form."""
    mean = (xx + yy + zz) / 3
    off = xy * xy + xz * xz + yz * yz
    spread = (xx - mean) ** 2 + (yy - mean) ** 2 + (zz - mean) ** 2 + 2 * off
    scale = np.sqrt(spread / 6)
    if scale <= 1e-14 * abs(mean):
        return mean
    a, b, c = (xx - mean) / scale, (yy - mean) / scale, (zz - mean) / scale
    d, e, f = xy / scale, xz / scale, yz / scale
    half = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2
    angle = np.arccos(min(1.0, max(-1.0, half))) / 3
    return mean + 2 * scale * np.cos(angle if largest else angle + 2 * np.pi / 3)


@numba.njit(cache=True, inline="always")
def eigenvector(xx, yy, zz, xy, xz, yz, value):
    """Unit eigenvector of a symmetric 3 x 3 matrix; the z axis where it is not unique."""
    a, b, c = xx - value, yy - value, zz - value
    # the eigenvector is across the rows: the longest of their cross products is the safest
    x1, y1, z1 = xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy
    x2, y2, z2 = xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz
    x3, y3, z3 = b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz
    n1, n2 = x1 * x1 + y1 * y1 + z1 * z1, x2 * x2 + y2 * y2 + z2 * z2
    n3 = x3 * x3 + y3 * y3 + z3 * z3
    if n1 >= n2 and n1 >= n3:
        x, y, z, n = x1, y1, z1, n1
    elif n2 >= n3:
        x, y, z, n = x2, y2, z2, n2
    else:
        x, y, z, n = x3, y3, z3, n3
    if n <= TINY:
        return 0.0, 0.0, 1.0
    n = np.sqrt(n)
    return x / n, y / n, z / n


@numba.njit(cache=True)
def _covariance(points, row, neighbors):
    """Second moments of a point and its neighbours around their mean, times their number."""
    k = len(neighbors)
    mx, my, mz = points[row, 0], points[row, 1], points[row, 2]
    for column in range(k):
        other = neighbors[column]
        mx += points[other, 0]
        my += points[other, 1]
        mz += points[other, 2]
    mx, my, mz = mx / (k + 1), my / (k + 1), mz / (k + 1)
    xx = yy = zz = xy = xz = yz = 0.0
    for column in range(-1, k):
        other = row if column < 0 else neighbors[column]
        x, y, z = points[other, 0] - mx, points[other, 1] - my, points[other, 2] - mz
        xx += x * x
        yy += y * y
        zz += z * z
        xy += x * y
        xz += x * z
        yz += y * z
    return xx, yy, zz, xy, xz, yz


@numba.njit(cache=True)
def neighborhood_spread(points, neighbors, n_near):
    """Spread of each point's neighbourhood across its main axis.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    neighbors : ndarray of shape (n_points, k), int
    n_near : ndarray of shape (n_points,), int
        How many of them, from the first, belong to the neighbourhood.

    Returns
    -------
    spread : ndarray of shape (n_points,), float64
        Mean squared distance from the main axis: the square of a branch's radius where the
        neighbourhood reaches around it, less where it holds only part of the circumference.
    flatness : ndarray of shape (n_points,), float64
        Difference of the two smaller variances over the largest: 0 for a tube or a line, 1 for a
        flat round patch.
    """
    spread, flatness = np.empty(len(points)), np.zeros(len(points))
    for row in range(len(points)):
        xx, yy, zz, xy, xz, yz = _covariance(points, row, neighbors[row, : n_near[row]])
        along = eigenvalue(xx, yy, zz, xy, xz, yz, True)
        through = eigenvalue(xx, yy, zz, xy, xz, yz, False)
        across = max(0.0, xx + yy + zz - along)
        spread[row] = across / (n_near[row] + 1)
        if along > 0:
            flatness[row] = min(1.0, max(0.0, (across - 2 * through) / along))
    return spread, flatness


@numba.njit(cache=True)
def neighborhood_axes(points, neighbors):
    """Main axis of each point's neighbourhood.

    Returns
    -------
    axes : ndarray of shape (n_points, 3), float64
        Unit vectors, their sign arbitrary.
    linearity : ndarray of shape (n_points,), float64
        Share of the variance along it, 1/3 for a ball, 1 for a line.
    """
    axes, linearity = np.empty((len(points), 3)), np.ones(len(points))
    for row in range(len(points)):
        xx, yy, zz, xy, xz, yz = _covariance(points, row, neighbors[row])
        along = eigenvalue(xx, yy, zz, xy, xz, yz, True)
        axes[row] = eigenvector(xx, yy, zz, xy, xz, yz, along)
        if xx + yy + zz > 0:
            linearity[row] = along / (xx + yy + zz)
    return axes, linearity
