"""Centre lines of what is thin in an image, to a fraction of a pixel.

Lines are found as Steger does ("An Unbiased Detector of Curvilinear Structures", PAMI 1998): where
the image, smoothed, is darkest or brightest across the direction in which it is bent most.
"""

import cv2
import numpy as np

# Smoothing, px. Steger asks for at least the half width over the root of three, here for lines of
# up to four pixels; wider ones are found at a coarser size
SIGMA_PX = 1.2
# Least bend across a line, grey levels of 255 a square pixel. Twice the 12 levels of `raster`,
# the same contrast before the smoothing, spread over a line of one pixel
MIN_BEND = 5.5
# A line bends at least so many times more across than along; below, it is a blob or a crossing
# (guess)
MIN_ANISOTROPY = 2.0
DARK, BRIGHT = 1, 2


def slopes_of(image: np.ndarray) -> np.ndarray:
    """Return first and second derivatives of an image (height, width), uint8, once smoothed.

    They are dx, dy, dxx, dyy and dxy, (5, height, width) float32.
    """
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), SIGMA_PX)
    return np.stack(
        [
            cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8),
            cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8),
            cv2.filter2D(smooth, cv2.CV_32F, np.array([[1, -2, 1]], np.float32)),
            cv2.filter2D(smooth, cv2.CV_32F, np.array([[1], [-2], [1]], np.float32)),
            cv2.Sobel(smooth, cv2.CV_32F, 1, 1, ksize=3, scale=1 / 4),
        ]
    )


def line_points(slopes: np.ndarray, sign: int) -> tuple[np.ndarray, np.ndarray]:
    """Find the points of the `DARK` or of the `BRIGHT` lines of an image by its derivatives.

    The points, at most one a pixel, (n, 2) float64, are in px, pixel centres at (0.5, 0.5); with
    them come unit vectors across the lines, (n, 2) float64.
    """
    dx, dy, dxx, dyy, dxy = slopes if sign == DARK else -slopes
    middle, half = 0.5 * (dxx + dyy), cv2.magnitude(0.5 * (dxx - dyy), dxy)
    bend, along = middle + half, middle - half
    y, x = np.nonzero((bend >= MIN_BEND) & (bend >= MIN_ANISOTROPY * np.abs(along)))
    angle = 0.5 * np.arctan2(2.0 * dxy[y, x], dxx[y, x] - dyy[y, x]).astype(np.float64)
    across = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    step = -(dx[y, x] * across[:, 0] + dy[y, x] * across[:, 1]) / bend[y, x]
    offset = step[:, None] * across
    inside = np.abs(offset).max(axis=1) <= 0.5  # else the line runs through another pixel
    centers = np.stack([x, y], axis=1) + 0.5 + offset
    return centers[inside], across[inside]
