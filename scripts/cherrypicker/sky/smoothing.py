"""Smoothing that stops at edges: the domain transform, recursive form.

A pixel's value spreads to its neighbours along rows and columns, less the more the photo's colours
differ on the way [1]_. What no edge divides, as the clouds of one sky, comes to agree, however far
apart; what lies between twigs keeps to itself.

References
----------
.. [1] Gastal, Oliveira, "Domain Transform for Edge-Aware Image and Video Processing", SIGGRAPH
   2011, section 5.2.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

N_PASSES = 3


@njit(cache=True, nogil=True)
def _along_rows(values, distance, base):
    """Filter each row there and back; ``distance`` is that to the pixel on the left."""
    height, width = values.shape
    for y in range(height):
        for x in range(1, width):
            share = base ** distance[y, x]
            values[y, x] += share * (values[y, x - 1] - values[y, x])
        for x in range(width - 2, -1, -1):
            share = base ** distance[y, x + 1]
            values[y, x] += share * (values[y, x + 1] - values[y, x])


def smooth_within_edges(
    image: np.ndarray, values: np.ndarray, reach: float, contrast: float
) -> np.ndarray:
    """Smooth an image of values where a photo has no edges.

    Parameters
    ----------
    image : ndarray of shape (h, w, 3), float32 in [0, 1]
    values : ndarray of shape (h, w), float32
    reach : float
        Standard deviation of the smoothing in a part of one colour, pixels.
    contrast : float
        Colours that differ by this much, summed over the channels, are ``reach`` pixels apart.

    Returns
    -------
    ndarray of shape (h, w), float32
        Within the range of ``values``.
    """
    across, down = np.ones((2, *values.shape), np.float32)
    across[:, 1:] += reach / contrast * np.abs(np.diff(image, axis=1)).sum(axis=2)
    down[1:] += reach / contrast * np.abs(np.diff(image, axis=0)).sum(axis=2)
    down = np.ascontiguousarray(down.T)
    smooth = np.array(values, np.float32)
    for i in range(N_PASSES):
        # the spreads of the passes add up to ``reach`` and halve from one to the next
        sigma = reach * math.sqrt(3) * 2 ** (N_PASSES - i - 1) / math.sqrt(4**N_PASSES - 1)
        base = np.float32(math.exp(-math.sqrt(2) / sigma))
        _along_rows(smooth, across, base)
        turned = np.ascontiguousarray(smooth.T)
        _along_rows(turned, down, base)
        smooth = np.ascontiguousarray(turned.T)
    return smooth
