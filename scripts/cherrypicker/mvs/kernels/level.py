"""What the kernels of PatchMatch work on: a reference and its sources at one pyramid level.

A field is an array (height, width, 4) float32 of inverse depth, its slopes along x and y per pixel,
and the cost.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import NamedTuple

import numpy as np

from cherrypicker.mvs.kernels.compiled import in_parallel, kernel

# Samples of a patch; a multiple of the vector width, unused ones get weight zero
N_SAMPLES = 32
# Rows that a thread takes at a time
ROWS_AT_A_TIME = 16


class Level(NamedTuple):
    """One reference and its sources at one pyramid level, as the kernels take them.

    Attributes
    ----------
    color : ndarray of shape (height * width,), int32
        The reference, packed by :func:`cherrypicker.mvs.kernels.matching.pack_color`.
    width, height : int
        Its size.
    samples : ndarray of shape (3, 32), float32
        The window.
    offsets : ndarray of shape (32,), int64
        Its samples' places in ``color``, from the centre.
    radius : float32
        Its radius, px.
    inv_color : float32
        1 / (colour spread of the bilateral weight) ** 2.
    packed, layout, project : ndarray
        All sources' pixels, packed, one after the other; (n, 3) where each begins, its width and
        height; (n, 12) matrix A by rows and vector b.
    depth, back : ndarray
        The sources' inverse depth maps and the way back, for the geometric cost.
    n_best : int
        How many of the sources' costs, lowest first, make the cost.
    geometric_weight : float32
        What one pixel of inconsistency costs; 0 without the sources' maps.
    w_min, w_max : float32
        Range of inverse depth.
    w_px : float32
        Inverse depth that makes one pixel of parallax in a middling source.
    fx, fy, cx, cy : float32
        Focal lengths and principal point of the reference at this level, px.
    """

    color: np.ndarray
    width: int
    height: int
    samples: np.ndarray
    offsets: np.ndarray
    radius: np.float32
    inv_color: np.float32
    packed: np.ndarray
    layout: np.ndarray
    project: np.ndarray
    depth: np.ndarray
    back: np.ndarray
    n_best: int
    geometric_weight: np.float32
    w_min: np.float32
    w_max: np.float32
    w_px: np.float32
    fx: np.float32
    fy: np.float32
    cx: np.float32
    cy: np.float32


class State(NamedTuple):
    """What the pixels of a level hold.

    Attributes
    ----------
    field : ndarray of shape (height, width, 4), float32
        Their hypotheses and costs.
    chosen : ndarray of shape (height, width), uint16
        Their best sources, four bits each.
    active : ndarray of shape (height, width), uint8
        Whether they are worked on.
    """

    field: np.ndarray
    chosen: np.ndarray
    active: np.ndarray


class Scratch(NamedTuple):
    """A thread's working memory.

    Attributes
    ----------
    patch : ndarray of shape (5, 32), float32
        Offsets and spatial weights of `Level.samples`, then the bilateral weights and centred,
        weighted grey values of the pixel at hand.
    costs : ndarray of shape (n_sources,), float32
    top : ndarray of shape (n_best,), int64
        The pixel's best sources.
    found : ndarray of shape (8, 2), int64
        Neighbours worth a try.
    order : ndarray of shape (4,), float32
        Colour distances of coarse pixels.
    pixels : ndarray of shape (32,), int32
        Packed colours of the patch.
    """

    patch: np.ndarray
    costs: np.ndarray
    top: np.ndarray
    found: np.ndarray
    order: np.ndarray
    pixels: np.ndarray


def by_rows(function: Callable[..., None]) -> Callable[..., None]:
    """Compile a kernel of some rows of a level, to be called for all of them.

    The kernel takes the level, its first row and the one after its last, arguments of its own and a
    `Scratch`. A caller gives the level, the number of threads and the arguments.
    """
    rows = kernel(function)

    @wraps(function)
    def over_rows(level: Level, threads: int, *arguments: object) -> None:
        def work(first: int) -> None:
            patch = np.zeros((5, N_SAMPLES), dtype=np.float32)
            patch[:3] = level.samples
            scratch = Scratch(
                patch=patch,
                costs=np.empty(len(level.layout), dtype=np.float32),
                top=np.zeros(level.n_best, dtype=np.int64),
                found=np.empty((8, 2), dtype=np.int64),
                order=np.empty(4, dtype=np.float32),
                pixels=np.zeros(N_SAMPLES, dtype=np.int32),
            )
            rows(level, first, min(first + ROWS_AT_A_TIME, level.height), *arguments, scratch)

        in_parallel(work, range(0, level.height, ROWS_AT_A_TIME), threads)

    return over_rows
