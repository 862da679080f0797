"""Fast pictures of point clouds: every point becomes a few pixels, the nearest one on top."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cherrypicker.report.style import MARGIN


@dataclass(frozen=True)
class View:
    """An orthographic view of part of the scene."""

    # right, up: (3,): unit directions in the world of the picture's axes
    right: np.ndarray
    up: np.ndarray
    # low, high: (2,): extent along them, in the cloud's unit
    low: np.ndarray
    high: np.ndarray
    name: str

    @property
    def aspect(self) -> float:
        """Height over width."""
        width, height = self.high - self.low
        return float(height / width)

    def flatten(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates in the picture (n, 2) and nearness to the viewer (n,)."""
        flat = points @ np.stack([self.right, self.up], axis=1)
        return flat, points @ np.cross(self.right, self.up)


def side_views(
    points: np.ndarray, *, margin: float = MARGIN["tree"], kinds: tuple = ("front", "side", "top")
) -> list[View]:
    """Views of the box of some points.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
        What must be in the pictures, z up.
    margin : float, default 0.05
        Part of the box's largest side to leave free on every side.
    kinds : tuple of str
        Of "front" (along +y), "side" (along -x) and "top".
    """
    x, y, z = np.eye(3)
    axes = {"front": (x, z), "side": (y, z), "top": (x, y)}
    low, high = points.min(axis=0), points.max(axis=0)
    free = margin * max(float((high - low).max()), 1e-6)
    views = []
    for kind in kinds:
        right, up = axes[kind]
        pick = np.stack([right, up])
        views.append(View(right, up, pick @ low - free, pick @ high + free, kind))
    return views


def splat(
    points: np.ndarray,
    colors: np.ndarray | tuple[float, ...],
    view: View,
    width: int,
    *,
    size: int = 2,
) -> np.ndarray:
    """Draw points into a white image.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
    colors : ndarray of shape (n, 3) or (3,), float
        RGB in [0, 1].
    width : int
        Of the image, px; its height follows from the view.
    size : int, default 2
        Side of a point, px.

    Returns
    -------
    ndarray of shape (height, width, 3), float32
        The first row is the top.
    """
    height = max(int(round(width * view.aspect)), 1)
    image = np.ones((height, width, 3), dtype=np.float32)
    flat, nearness = view.flatten(points)
    scale = width / (view.high[0] - view.low[0])
    column = np.floor((flat[:, 0] - view.low[0]) * scale).astype(np.int64)
    row = height - 1 - np.floor((flat[:, 1] - view.low[1]) * scale).astype(np.int64)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    order = np.flatnonzero(inside)[np.argsort(nearness[inside], kind="stable")]
    colors = np.broadcast_to(np.asarray(colors, dtype=np.float32), (len(points), 3))[order]
    row, column = row[order], column[order]
    depth = np.full((height, width), -np.inf)
    near = nearness[order]
    for down in range(size):
        for right in range(size):
            # NumPy keeps the last of repeated indices, which is the nearest point
            r = np.minimum(row + down, height - 1)
            c = np.minimum(column + right, width - 1)
            wins = near >= depth[r, c]
            r, c = r[wins], c[wins]
            image[r, c] = colors[wins]
            depth[r, c] = near[wins]
    return image
