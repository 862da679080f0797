"""Centre lines of what is thin and dark before clear sky.

Only blue is looked at, in which wood and sky differ most, and only dark lines: a gap between two
twigs is a bright one. A line counts where the photo's sky mask has sky on both of its sides.
"""

from typing import NamedTuple

import cv2
import numpy as np

from cherrypicker.mvs.lines.ridges import DARK, line_points, slopes_of
from cherrypicker.mvs.raster import CLEAR_BELOW, HIDDEN, SOLID

# How far aside of a line its sky is looked for, px: past the blur and the border of a mask
# (guess)
FLANK_PX = (3.0, 7.0)
# Window in which the density of lines is counted, px: some twigs wide (guess)
DENSITY_PX = 65
# Pixels that are at least so far from all but clear sky show nothing but sky, px (guess)
CLEARANCE_PX = 1


class SkyLines(NamedTuple):
    """Thin lines before the sky in one photo."""

    # (n, 2) float64: points of the lines, at most one a pixel, px, pixel centres at (0.5, 0.5)
    uv: np.ndarray
    across: np.ndarray  # (n, 2) float64: unit vectors across the lines
    # (n,) float64: share of the sky around that lies as near to a line as two photos may disagree:
    # the probability that a place shows a line by chance
    share: np.ndarray
    clear: np.ndarray  # (height, width) bool: pixels of nothing but sky


def find_sky_lines(photo: np.ndarray, raster: np.ndarray, tolerance_px: float) -> SkyLines:
    """Find the thin dark lines before the sky of a photo, RGB (height, width, 3) uint8.

    The raster, (height, width) uint8, holds what it shows, see `cherrypicker.mvs.raster`. A place
    counts as on a line within ``tolerance_px`` of it.
    """
    sky = raster < SOLID
    centers, across = line_points(slopes_of(photo[..., 2]), DARK)
    flanked = _has_sky_aside(sky, centers, across)
    centers, across = centers[flanked], across[flanked]
    x, y = np.floor(centers).astype(int).T
    on_line = np.zeros(sky.shape, np.float32)
    on_line[y, x] = 2.0 * tolerance_px
    window = (DENSITY_PX, DENSITY_PX)
    lines = cv2.boxFilter(on_line, -1, window, normalize=False)
    open_sky = cv2.boxFilter(sky.astype(np.float32), -1, window, normalize=False)
    share = (lines / np.maximum(open_sky + lines, 1.0))[y, x].astype(np.float64)
    # The edge of what a user hides is no twig
    around = np.ones((2 * int(FLANK_PX[1]) + 1,) * 2, np.uint8)
    near_hidden = cv2.dilate((raster == HIDDEN).astype(np.uint8), around)
    seen = near_hidden[y, x] == 0
    pixels = (raster < CLEAR_BELOW).astype(np.uint8)
    clear = cv2.erode(pixels, np.ones((2 * CLEARANCE_PX + 1,) * 2, np.uint8)) > 0
    return SkyLines(centers[seen], across[seen], share[seen], clear)


def _has_sky_aside(sky: np.ndarray, centers: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Whether each point of a line has sky on both sides, (n,) bool."""
    both = np.ones(len(centers), bool)
    for side in (-1.0, 1.0):
        found = np.zeros(len(centers), bool)
        for distance in np.arange(FLANK_PX[0], FLANK_PX[1] + 0.5):
            at = np.floor(centers + side * distance * across).astype(int)
            inside = (at >= 0).all(axis=1) & (at < sky.shape[::-1]).all(axis=1)
            found[inside] |= sky[at[inside, 1], at[inside, 0]]
        both &= found
    return both
