"""Where the markers of a scan stand, by what `estimate_scale` solved: a hard fact for the labels.

A solved square is a marker; where one may stand that was not solved the class stays open; anywhere
else is none.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

THICKNESS = 1.5  # voxels: how far off a marker's plane its print is looked for (a guess)
QUIET_ZONE = 1 / 6  # of the side: a module of a 4 x 4 marker, white around the print (OpenCV)
# Sides beyond the print: its board reaches no farther. Halved and doubled, it changes no label of
# three scans; without an end, signs of all three become markers
BOARD = 0.5


@dataclass(frozen=True)
class KnownMarkers:
    """The solved markers of a scan, and where boards may be that were not solved.

    Where nobody looked for markers none is solved, and one may be anywhere.
    """

    # (n, 4, 3) float64: corners of each black square, one after the other
    squares: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 3)))
    # (m, 4) float64: x, y, z and radius
    open_places: np.ndarray = field(default_factory=lambda: np.array([[0, 0, 0, np.inf]]))

    def hold(self, points: np.ndarray, voxel: float, margin: float = QUIET_ZONE) -> np.ndarray:
        """Which points (n, 3) lie in a square's plane, on its print or `margin` sides off it."""
        mask = np.zeros(len(points), dtype=bool)
        for a, b, c, d in self.squares:
            sides = np.stack([b + c - a - d, c + d - a - b]) / 2  # of both directions, their means
            normal = np.cross(*sides)
            offset = points - (a + b + c + d) / 4
            in_sides = np.abs(offset @ sides.T) / np.square(sides).sum(axis=1)
            away = np.abs(offset @ normal) / np.linalg.norm(normal)
            mask |= (in_sides.max(axis=1) <= 0.5 + margin) & (away <= THICKNESS * voxel)
        return mask

    def is_open(self, points: np.ndarray) -> np.ndarray:
        """Which points (n, 3) may be of a marker that was not solved, or of what carries one."""
        mask = np.zeros(len(points), dtype=bool)
        for square in self.squares:
            middle = square.mean(axis=0)
            away = np.linalg.norm((points - middle)[:, :2], axis=1)
            half = np.linalg.norm(square - middle, axis=1).mean() / np.sqrt(2)
            mask |= (away <= half * (1 + 2 * BOARD)) & (points[:, 2] < middle[2])
        for *center, radius in self.open_places:
            mask |= np.linalg.norm(points - center, axis=1) <= radius
        return mask


def known_markers(scale: dict[str, Any], align: dict[str, Any]) -> KnownMarkers:
    """The markers of a scan in the metric frame, by its scale.json and align.json."""
    matrix = np.array(align["transform"], dtype=np.float64)
    matrix[:3] *= scale["scale"] or 1.0
    found = [*scale["markers"], *scale["other_markers"]]
    corners = [one["corners"] for one in found if one.get("corners") and one.get("is_square", True)]
    squares = np.reshape(corners, (-1, 4, 3)) @ matrix[:3, :3].T + matrix[:3, 3]
    zoom = np.cbrt(np.linalg.det(matrix[:3, :3])) * (1 + 2 * BOARD)
    places = [
        [*(matrix[:3, :3] @ place["center"] + matrix[:3, 3]), zoom * place["radius"]]
        for place in scale["unsolved_markers"]
    ]
    return KnownMarkers(squares, np.reshape(places, (-1, 4)))
