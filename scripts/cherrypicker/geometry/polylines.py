"""Polylines: arc lengths, nearest places, values in between, straight continuations."""

import numba
import numpy as np

from cherrypicker.geometry.local_frames import eigenvalue, eigenvector
from cherrypicker.geometry.ordering import first_not_below

__all__ = [
    "along_polyline",
    "arc_length",
    "between",
    "interpolate",
    "meet_backwards",
    "nearest_on_polyline",
    "nearest_places",
    "straight_back",
]

N_PLACES = 81  # on a parent's axis that a side axis may start from


def arc_length(points):
    """Arc length of each point of a polyline, (n,) float64, 0 at the first."""
    return along_polyline(np.ascontiguousarray(points, dtype=np.float64))


@numba.njit(cache=True)
def along_polyline(points):
    """`arc_length`, compiled; further columns after x, y and z do not count."""
    along = np.zeros(len(points))
    for row in range(1, len(points)):
        x = points[row, 0] - points[row - 1, 0]
        y = points[row, 1] - points[row - 1, 1]
        z = points[row, 2] - points[row - 1, 2]
        along[row] = along[row - 1] + np.sqrt(x * x + y * y + z * z)
    return along


def nearest_on_polyline(polyline, points):
    """Nearest place on a polyline for each point.

    Parameters
    ----------
    polyline : ndarray of shape (n, 3)
    points : ndarray of shape (m, 3)

    Returns
    -------
    at : ndarray of shape (m,)
        Arc length of the nearest place.
    distance : ndarray of shape (m,)
    """
    return nearest_places(
        np.ascontiguousarray(polyline, dtype=np.float64),
        np.ascontiguousarray(points, dtype=np.float64),
    )


@numba.njit(cache=True)
def nearest_places(line, points):
    """`nearest_on_polyline`, compiled."""
    place, distance = np.zeros(len(points)), np.full(len(points), np.inf)
    travelled = 0.0
    for piece in range(max(len(line) - 1, 1)):
        end = min(piece + 1, len(line) - 1)
        dx = line[end, 0] - line[piece, 0]
        dy = line[end, 1] - line[piece, 1]
        dz = line[end, 2] - line[piece, 2]
        squared = max(dx * dx + dy * dy + dz * dz, 1e-24)
        for row in range(len(points)):
            x = points[row, 0] - line[piece, 0]
            y = points[row, 1] - line[piece, 1]
            z = points[row, 2] - line[piece, 2]
            share = min(max((x * dx + y * dy + z * dz) / squared, 0.0), 1.0)
            x, y, z = x - share * dx, y - share * dy, z - share * dz
            away = x * x + y * y + z * z
            if away < distance[row]:
                distance[row], place[row] = away, travelled + share * np.sqrt(squared)
        travelled += np.sqrt(squared)
    for row in range(len(points)):
        distance[row] = np.sqrt(distance[row])
    return place, distance


def interpolate(strand_points, values, at):
    """Values along a polyline at given arc lengths (columns one by one)."""
    values = np.ascontiguousarray(values, dtype=np.float64)
    along = along_polyline(np.ascontiguousarray(strand_points))
    at = np.ascontiguousarray(at, dtype=np.float64)
    if values.ndim == 1:
        return np.interp(at, along, values)
    return between(along, values, at)


@numba.njit(cache=True)
def between(along, values, at):
    """Rows of `values`, known at increasing arc lengths, at other arc lengths (compiled)."""
    found = np.empty((len(at), values.shape[1]))
    for row in range(len(at)):
        above = min(max(first_not_below(along, at[row]), 1), len(along) - 1)
        below = max(above - 1, 0)
        length = along[above] - along[below]
        share = (at[row] - along[below]) / length if length > 0 else 0.0
        share = min(max(share, 0.0), 1.0)
        for column in range(values.shape[1]):
            step = values[above, column] - values[below, column]
            found[row, column] = values[below, column] + share * step
    return found


def straight_back(line, run, around, window, limit):
    """Place on a polyline that the straight continuation of a run of points backwards meets.

    Parameters
    ----------
    line : ndarray of shape (n, 3), float64
        The parent's axis.
    run : ndarray of shape (m, 3), float64
        Points outwards along the side axis.
    around, window : float
        Arc length on the line that is looked around, and how far either way.
    limit : float
        Largest distance between the line and the continuation.

    Returns
    -------
    place : float
        Arc length; NaN where the two do not meet.
    cosine : float
        Of the angle between the two there.
    """
    return meet_backwards(
        np.ascontiguousarray(line), np.ascontiguousarray(run), around, window, limit
    )


@numba.njit(cache=True)
def meet_backwards(line, run, around, window, limit):
    """`straight_back`, compiled."""
    along = along_polyline(line)
    cx, cy, cz, u, v, w = _direction(run)
    low, high = max(0.0, around - window), min(along[-1], around + window)
    at = np.empty(N_PLACES)
    for row in range(N_PLACES):
        at[row] = low + (high - low) * row / (N_PLACES - 1)
    spots = between(along, line, at)
    best, least = -1, np.inf
    for row in range(N_PLACES):
        x, y, z = spots[row, 0] - cx, spots[row, 1] - cy, spots[row, 2] - cz
        ahead = x * u + y * v + z * w
        aside = np.sqrt(max(x * x + y * y + z * z - ahead * ahead, 0.0))
        if ahead <= 0 and aside < least:  # only backwards
            best, least = row, aside
    if best < 0 or least > limit:
        return np.nan, 0.0
    above, below = min(best + 1, N_PLACES - 1), max(best - 1, 0)
    x, y = spots[above, 0] - spots[below, 0], spots[above, 1] - spots[below, 1]
    z = spots[above, 2] - spots[below, 2]
    return at[best], abs(x * u + y * v + z * w) / max(np.sqrt(x * x + y * y + z * z), 1e-12)


@numba.njit(cache=True)
def _direction(run):
    """Middle (x, y, z) and main direction (u, v, w) of points, from the first to the last."""
    n = len(run)
    cx = cy = cz = 0.0
    for row in range(n):
        cx, cy, cz = cx + run[row, 0] / n, cy + run[row, 1] / n, cz + run[row, 2] / n
    xx = yy = zz = xy = xz = yz = 0.0
    for row in range(n):
        x, y, z = run[row, 0] - cx, run[row, 1] - cy, run[row, 2] - cz
        xx, yy, zz = xx + x * x, yy + y * y, zz + z * z
        xy, xz, yz = xy + x * y, xz + x * z, yz + y * z
    first = eigenvalue(xx, yy, zz, xy, xz, yz, True)
    u, v, w = eigenvector(xx, yy, zz, xy, xz, yz, first)
    x, y, z = run[n - 1, 0] - run[0, 0], run[n - 1, 1] - run[0, 1], run[n - 1, 2] - run[0, 2]
    if u * x + v * y + w * z < 0:
        u, v, w = -u, -v, -w
    return cx, cy, cz, u, v, w
