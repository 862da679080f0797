"""Fast pictures of point clouds: every point becomes a few pixels, the nearest one on top."""

from typing import NamedTuple

import numpy as np

from cherrypicker.report.style import MARGIN

# Axes of the world that run to the right, up and along each view; the front is seen along +y, the
# side along -x
AXES = {"front": (0, 2, 1), "side": (1, 2, 0), "top": (0, 1, 2)}


class View(NamedTuple):
    """An orthographic view of part of the scene: "front", "side" or "top"."""

    name: str
    # low, high: (2,): extent to the right and up, in the cloud's unit
    low: np.ndarray
    high: np.ndarray

    @property
    def aspect(self) -> float:
        """Height over width."""
        width, height = self.high - self.low
        return float(height / width)

    def flatten(self, points: np.ndarray) -> np.ndarray:
        """Coordinates in the picture, (n, 2)."""
        return points[:, AXES[self.name][:2]]


def side_views(points: np.ndarray, *, kinds: tuple = ("front", "side", "top")) -> list[View]:
    """Views of the box of some points (n, 3), float64, z up, that must be in the pictures."""
    low, high = points.min(axis=0), points.max(axis=0)
    free = MARGIN * max(float((high - low).max()), 1e-6)
    return [View(kind, *(np.array([low - free, high + free])[:, AXES[kind][:2]])) for kind in kinds]


def splat(
    points: np.ndarray, colors: np.ndarray | tuple[float, ...], view: View, width: int, size: int
) -> np.ndarray:
    """Draw points (n, 3), float64, into a clear image, (height, width, 4) float32.

    Its first row is the top. Colours, (n, 3) or (3,), are RGB in [0, 1]. The width of the image is
    in px, its height follows from the view; a point is a square whose side has ``size`` px.
    """
    height = max(int(round(width * view.aspect)), 1)
    image = np.zeros((height, width, 4), dtype=np.float32)
    scale = width / (view.high[0] - view.low[0])
    column, row = np.floor((view.flatten(points) - view.low) * scale).astype(np.int64).T
    row = height - 1 - row
    inside = np.flatnonzero((column >= 0) & (column < width) & (row >= 0) & (row < height))
    away = points[inside, AXES[view.name][2]]
    order = inside[np.argsort(-away if view.name == "front" else away, kind="stable")]
    colors = np.broadcast_to(np.asarray(colors, dtype=np.float32), (len(points), 3))[order]
    more = np.arange(size)
    rows = np.minimum(row[order, None, None] + more[:, None], height - 1)
    columns = np.minimum(column[order, None, None] + more, width - 1)
    # NumPy keeps the last of repeated indices, which is the nearest point
    image[rows, columns, :3] = colors[:, None, None]
    image[rows, columns, 3] = 1.0
    return image
