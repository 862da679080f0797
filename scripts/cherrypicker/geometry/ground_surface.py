"""Height of the ground below a place, from the ground seen around it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["GroundSurface"]


class GroundSurface:
    """Height of hilly ground: median of what lies nearest in x and y.

    Parameters
    ----------
    cells : ndarray of shape (n_cells, 3)
        Ground points, or means of such; without any the ground is z = 0.
    n_nearest : int, default 5
    """

    def __init__(self, cells: np.ndarray, n_nearest: int = 5) -> None:
        self._heights, self._n_nearest = cells[:, 2], n_nearest
        self._tree = cKDTree(cells[:, :2]) if len(cells) else None

    def __call__(self, xy: np.ndarray) -> np.ndarray:
        """Ground heights, shape (n,), at x, y of shape (n, 2)."""
        if self._tree is None:
            return np.zeros(len(xy))
        _, index = self._tree.query(xy, k=min(self._n_nearest, len(self._heights)))
        return np.median(self._heights[np.reshape(index, (len(xy), -1))], axis=1)
