"""Where to stand for photos that would tell what the photos at hand leave open.

What is unsure stands before hills, ground or other wood in the photos, or they contradict one
another there. The photos themselves show in which directions the scan has sky. So from places
around the tree those are chosen, one by one, from which most of what is unsure would stand before
the sky, as many pixels wide as can be told.
"""

from itertools import product
from typing import Any

import numpy as np

from cherrypicker.evidence.coverage import STEP_PX
from cherrypicker.evidence.witnesses import THIN_PX
from cherrypicker.files import rounded
from cherrypicker.mvs.raster import HIDDEN, SOLID
from cherrypicker.mvs.scan_photos import ScanPhotos

# Directions are counted in cells of so many degrees, and one may stand in as many
CELL_DEG = 15
# Shares of the cameras' median distance and of their median height over the root at which one may
DISTANCES, HEIGHTS = (0.5, 1.0), (0.3, 1.0, 1.5)
# Share of what is unsure that makes a photo worth its while
WORTH = 0.1


def where_to_stand(
    photos: ScanPhotos,
    root: np.ndarray,
    points: np.ndarray,
    radius: np.ndarray,
    unsure: np.ndarray,
) -> list[dict[str, Any]]:
    """Choose places for photos of what is unsure.

    Of wood at points (n, 3) with a radius (n,) such a length (n,) is unsure; the root (3,) is the
    stem's foot, z is up. The most useful comes first: ``azimuth_deg``, ``distance`` and ``height``
    over the root of where to stand, ``at``, the middle of what to look at, and ``unsure_length`` of
    wood that would stand before the sky.
    """
    rows = np.flatnonzero(unsure > 0)
    if not len(rows):
        return []
    left = unsure[rows]
    total = float(left.sum())
    n_cells = (360 // CELL_DEG) * (180 // CELL_DEG)
    seen, sky = np.zeros((2, n_cells))
    for i, view in enumerate(photos.views):
        raster = photos.raster(i)[::STEP_PX, ::STEP_PX]
        y, x = np.nonzero(raster != HIDDEN)
        cell = _cells(view.rays(STEP_PX * np.column_stack([x, y]) + 0.5))
        seen += np.bincount(cell, minlength=n_cells)
        sky += np.bincount(cell, raster[y, x] < SOLID, minlength=n_cells)
    sky /= np.maximum(seen, 1.0)  # share of a cell's pixels, 0 where no photo looks
    off = photos.poses.centers - root
    usual, height = np.median(np.hypot(off[:, 0], off[:, 1])), np.median(off[:, 2])
    turn = np.radians(np.arange(0, 360, CELL_DEG))
    stands = root + [
        (far * usual * np.cos(a), far * usual * np.sin(a), up * height)
        for a, far, up in product(turn, DISTANCES, HEIGHTS)
    ]
    told = []
    focal = float(np.median(photos.poses.K[:, 0, 0]))
    for stand in stands:
        way = points[rows] - stand
        distance = np.linalg.norm(way, axis=1)
        width = 2.0 * radius[rows] * focal / np.maximum(distance, 1e-9)
        told.append(sky[_cells(way)] * np.minimum(width / THIN_PX, 1.0))
    chosen = []
    while True:
        gains = np.array([each @ left for each in told])
        best = int(np.argmax(gains))
        if not gains[best] >= WORTH * total:
            break
        x, y, z = stands[best] - root
        middle = np.average(points[rows], axis=0, weights=told[best] * left)
        chosen.append(
            {
                "azimuth_deg": round(float(np.degrees(np.arctan2(y, x)) % 360.0)),
                "distance": rounded(np.hypot(x, y)),
                "height": rounded(z),
                "at": [rounded(value) for value in middle],
                "unsure_length": rounded(gains[best]),
            }
        )
        left = left * (1.0 - told[best])
    return chosen


def _cells(ways: np.ndarray) -> np.ndarray:
    """The cell of directions that each way (n, 3) lies in, (n,) int64."""
    azimuth = np.degrees(np.arctan2(ways[:, 1], ways[:, 0])) % 360.0
    elevation = np.degrees(np.arctan2(ways[:, 2], np.hypot(ways[:, 0], ways[:, 1])))
    n_up = 180 // CELL_DEG
    across = (azimuth // CELL_DEG).astype(int) % (360 // CELL_DEG)
    return across * n_up + np.minimum((elevation + 90.0) // CELL_DEG, n_up - 1).astype(int)
