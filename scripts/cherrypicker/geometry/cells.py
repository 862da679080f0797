"""Which places have points near: points sorted into cells, looked up by columns of cells."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np

from cherrypicker.geometry.ordering import first_not_below

__all__ = ["Cells", "have_company", "rows_in_box", "sort_into_cells"]

_MOST_CELLS = 2.0**62


@dataclass
class Cells:
    """Points sorted by the cell that holds them.

    Attributes
    ----------
    points : ndarray of shape (n_points, 3), float64
        In the order of their cells.
    key : ndarray of shape (n_points,), int64
        Number of each one's cell, increasing.
    low, shape : ndarray of shape (3,)
        Corner of the first cell, and cells along each axis.
    size : float
        Side of a cell.
    order : ndarray of shape (n_points,), int64
        Rows that the points had before.
    """

    points: np.ndarray
    key: np.ndarray
    low: np.ndarray
    shape: np.ndarray
    size: float
    order: np.ndarray

    def select(self, chosen: np.ndarray) -> Cells:
        """Those points that `chosen`, (n_points,) bool in their old order, names."""
        rows = np.flatnonzero(chosen[self.order])
        return replace(self, points=self.points[rows], key=self.key[rows], order=self.order[rows])


def sort_into_cells(points: np.ndarray, size: float) -> Cells:
    """Sort points into cubic cells.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        One at least.
    size : float
        Side of a cell; larger where the cells' numbers would not fit 64 bits.

    Returns
    -------
    Cells
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    low, high = _ends(points)
    extent = high - low
    while np.prod(extent / size + 1.0) > _MOST_CELLS:
        size *= 2.0
    shape = (extent // size).astype(np.int64) + 1
    key = _keys(points, low, shape, size)
    order = np.argsort(key, kind="stable")
    return Cells(points[order], key[order], low, shape, float(size), order)


def have_company(cells: Cells, places: np.ndarray, reach: np.ndarray, n_points: int) -> np.ndarray:
    """Places with points near.

    Parameters
    ----------
    cells : Cells
    places : ndarray of shape (n_places, 3), float64
    reach : ndarray of shape (n_places,), float64
    n_points : int
        Points asked for within `reach`; a place that is one of the points counts itself.

    Returns
    -------
    ndarray of shape (n_places,), bool
    """
    places = np.ascontiguousarray(places, dtype=np.float64)
    return _company(
        cells.points, cells.key, cells.low, cells.shape, cells.size, places, reach, n_points
    )


def rows_in_box(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Rows of points (n, 3) between two corners (3,) of a box, faces included, in order."""
    return _rows_in_box(np.ascontiguousarray(points, dtype=np.float64), low, high)


@numba.njit(cache=True)
def _rows_in_box(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    rows, n = np.empty(len(points), dtype=np.int64), 0
    for row in range(len(points)):
        inside = True
        for axis in range(3):
            inside &= low[axis] <= points[row, axis] <= high[axis]
        rows[n] = row
        n += inside
    return rows[:n].copy()


@numba.njit(cache=True)
def _ends(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest of each coordinate."""
    low, high = points[0].copy(), points[0].copy()
    for row in range(len(points)):
        for axis in range(3):
            low[axis] = min(low[axis], points[row, axis])
            high[axis] = max(high[axis], points[row, axis])
    return low, high


@numba.njit(cache=True)
def _keys(points: np.ndarray, low: np.ndarray, shape: np.ndarray, size: float) -> np.ndarray:
    """Number of the cell of each point."""
    key = np.empty(len(points), dtype=np.int64)
    for row in range(len(points)):
        number = 0
        for axis in range(3):
            cell = min(int((points[row, axis] - low[axis]) // size), shape[axis] - 1)
            number = number * shape[axis] + cell
        key[row] = number
    return key


@numba.njit(cache=True)
def _company(
    points: np.ndarray,
    key: np.ndarray,
    low: np.ndarray,
    shape: np.ndarray,
    size: float,
    places: np.ndarray,
    reach: np.ndarray,
    n_points: int,
) -> np.ndarray:
    """Walk the columns of cells around each place, the nearest first, until enough are found."""
    enough, n = np.zeros(len(places), dtype=np.bool_), len(key)
    for place in range(len(places)):
        x, y, z = places[place]
        limit = reach[place] * reach[place]
        wide = int(np.ceil(reach[place] / size))
        i, j = int((x - low[0]) // size), int((y - low[1]) // size)
        first_k = max(int((z - reach[place] - low[2]) // size), 0)
        last_k = min(int((z + reach[place] - low[2]) // size), shape[2] - 1)
        found = 0
        for ring in range(wide + 1):
            for a in range(max(i - ring, 0), min(i + ring, shape[0] - 1) + 1):
                for b in range(max(j - ring, 0), min(j + ring, shape[1] - 1) + 1):
                    if max(abs(a - i), abs(b - j)) < ring:
                        continue
                    column = (a * shape[1] + b) * shape[2]
                    row = first_not_below(key, column + first_k)
                    while row < n and key[row] <= column + last_k:
                        u, v, w = points[row, 0] - x, points[row, 1] - y, points[row, 2] - z
                        found += u * u + v * v + w * w <= limit
                        if found >= n_points:
                            break
                        row += 1
                    if found >= n_points:
                        break
                if found >= n_points:
                    break
            if found >= n_points:
                enough[place] = True
                break
    return enough
