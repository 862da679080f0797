"""Cotangent Laplacian of a point cloud from the Delaunay star of each point (compiled)."""

import numba
import numpy as np
from scipy.sparse import csr_matrix, diags

from cherrypicker.geometry.local_frames import eigenvalue, eigenvector

__all__ = ["star_laplacian"]

SHORTEST = 1e-2  # of the typical edge: neighbours nearer than this are moved out to it
MAX_COTANGENT = 1e3


def star_laplacian(points, neighbors):
    """Cotangent Laplacian from Delaunay stars in the tangent planes.

    Each point's neighbours are projected to the plane that fits them best; the point's star in
    their Delaunay triangulation gives the cotangent weights of its edges and a third of its
    triangles' area the mass. Both ends of an edge see a triangulation of their own, and their
    weights are averaged.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    neighbors : ndarray of shape (n_points, k), int
        Candidates for each point's star, itself not among them.

    Returns
    -------
    L : scipy.sparse.csr_matrix of shape (n_points, n_points)
        Weak Laplacian, symmetric, positive semi-definite (positive diagonal, rows sum to 0).
    mass : ndarray of shape (n_points,), float64
        Area around each point.

    References
    ----------
    Cao et al.: Point Cloud Skeletons via Laplacian-Based Contraction. SMI 2010 (the local
    Delaunay neighbourhoods); Belkin, Sun, Wang: Constructing Laplace operator from point clouds in
    R^d. SODA 2009 (tangent planes).
    """
    neighbors = np.ascontiguousarray(neighbors)
    n, k = neighbors.shape
    length = np.linalg.norm(points[neighbors[:, k // 2]] - points, axis=1)
    shortest = max(SHORTEST * float(np.median(length)), 1e-12)
    weight, count, mass = _stars(points, neighbors, shortest)
    keep = weight > 0
    indptr = np.concatenate([[0], np.cumsum(count)])
    W = csr_matrix((weight[keep], neighbors[keep].astype(np.int32), indptr), shape=(n, n))
    W = 0.25 * (W + W.T)  # half the cotangents, the mean of both ends
    L = (diags(np.asarray(W.sum(axis=1)).ravel()) - W).tocsr()
    L.sort_indices()
    return L, mass


@numba.njit(cache=True, inline="always")
def _turn(qx, qy, a, b, c):
    """Twice the signed area of a triangle of inverted points."""
    return (qx[b] - qx[a]) * (qy[c] - qy[a]) - (qy[b] - qy[a]) * (qx[c] - qx[a])


@numba.njit(cache=True)
def _hull(qx, qy, order, hull):
    """Convex hull, counter-clockwise, its first point again at the end (Andrew's chains)."""
    m, h = len(order), 0
    for position in range(m):
        while h >= 2 and _turn(qx, qy, hull[h - 2], hull[h - 1], order[position]) <= 0:
            h -= 1
        hull[h] = order[position]
        h += 1
    low = h + 1
    for position in range(m - 2, -1, -1):
        while h >= low and _turn(qx, qy, hull[h - 2], hull[h - 1], order[position]) <= 0:
            h -= 1
        hull[h] = order[position]
        h += 1
    return h


@numba.njit(cache=True)
def _project(points, row, neighbors, shortest, u, v, qx, qy, order):
    """Neighbours in the tangent plane (u, v), inverted at the unit circle (qx, qy), sorted by qx.

    Circles through the point become lines under the inversion, so that the hull of the inverted
    points is the point's Delaunay star.
    """
    k = len(neighbors)
    xx = yy = zz = xy = xz = yz = mx = my = mz = 0.0
    for column in range(k):
        x = points[neighbors[column], 0] - points[row, 0]
        y = points[neighbors[column], 1] - points[row, 1]
        z = points[neighbors[column], 2] - points[row, 2]
        mx, my, mz = mx + x, my + y, mz + z
        xx, yy, zz = xx + x * x, yy + y * y, zz + z * z
        xy, xz, yz = xy + x * y, xz + x * z, yz + y * z
    xx, yy, zz = xx - mx * mx / k, yy - my * my / k, zz - mz * mz / k
    xy, xz, yz = xy - mx * my / k, xz - mx * mz / k, yz - my * mz / k
    low = eigenvalue(xx, yy, zz, xy, xz, yz, False)
    nx, ny, nz = eigenvector(xx, yy, zz, xy, xz, yz, low)
    if abs(nx) <= abs(ny) and abs(nx) <= abs(nz):
        ax, ay, az = 1.0 - nx * nx, -nx * ny, -nx * nz
    elif abs(ny) <= abs(nz):
        ax, ay, az = -ny * nx, 1.0 - ny * ny, -ny * nz
    else:
        ax, ay, az = -nz * nx, -nz * ny, 1.0 - nz * nz
    norm = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / norm, ay / norm, az / norm
    bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    for column in range(k):
        x = points[neighbors[column], 0] - points[row, 0]
        y = points[neighbors[column], 1] - points[row, 1]
        z = points[neighbors[column], 2] - points[row, 2]
        p, q = x * ax + y * ay + z * az, x * bx + y * by + z * bz
        r = np.sqrt(p * p + q * q)
        if r < 1e-3 * shortest:  # points that have met: any direction, not the same for all
            p, q, r = shortest * np.cos(2.4 * column), shortest * np.sin(2.4 * column), shortest
        elif r < shortest:
            p, q, r = p * shortest / r, q * shortest / r, shortest
        u[column], v[column] = p, q
        qx[column], qy[column] = p / (r * r), q / (r * r)
        place = column
        while place > 0 and (
            qx[order[place - 1]] > qx[column]
            or (qx[order[place - 1]] == qx[column] and qy[order[place - 1]] > qy[column])
        ):
            order[place] = order[place - 1]
            place -= 1
        order[place] = column


@numba.njit(cache=True)
def _stars(points, neighbors, shortest):
    """Sum of the two cotangents opposite each edge of each star, its edges and its mass."""
    n, k = neighbors.shape
    weight, count, mass = np.zeros((n, k)), np.zeros(n, np.int64), np.zeros(n)
    u, v, qx, qy = np.empty(k), np.empty(k), np.empty(k), np.empty(k)
    order, hull = np.empty(k, np.int64), np.empty(2 * k + 2, np.int64)
    for row in range(n):
        _project(points, row, neighbors[row], shortest, u, v, qx, qy, order)
        own, area = weight[row], 0.0
        for position in range(_hull(qx, qy, order, hull) - 1):
            a, b = hull[position], hull[position + 1]
            outside = (qx[b] - qx[a]) * qy[a] - (qy[b] - qy[a]) * qx[a] >= 0
            cross = u[a] * v[b] - v[a] * u[b]
            if outside or cross <= 0:  # the star is open here: a border of the cloud
                continue
            area += cross
            dot = u[a] * u[b] + v[a] * v[b]
            at_a = (u[a] * u[a] + v[a] * v[a] - dot) / cross
            at_b = (u[b] * u[b] + v[b] * v[b] - dot) / cross
            own[b] += min(max(at_a, -MAX_COTANGENT), MAX_COTANGENT)
            own[a] += min(max(at_b, -MAX_COTANGENT), MAX_COTANGENT)
        mass[row] = area / 6
        for column in range(k):
            if own[column] > 0:
                count[row] += 1
    return weight, count, mass
