"""What the kernels of PatchMatch work on: a reference and its sources at one pyramid level.

A field is an array (height, width, 4) float32 of inverse depth, its slopes along x and y per pixel,
and the cost. Kernels take a block of the level's rows and a thread's working memory.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cherrypicker.mvs.kernels.compiled import in_parallel
from cherrypicker.mvs.kernels.matching import N_SAMPLES

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


class Scratch(NamedTuple):
    """A thread's working memory.

    Attributes
    ----------
    patch : ndarray of shape (5, 32), float32
        See :func:`cherrypicker.mvs.kernels.matching.prepare_patch`.
    costs : ndarray of shape (n_sources,), float32
    top : ndarray of shape (n_best,), int64
        The pixel's best sources.
    found : ndarray of shape (8, 2), int64
        Neighbours worth a try.
    order : ndarray of shape (4,), float32
        Colour distances of coarse pixels.
    pixels : ndarray of shape (32,), int32
        See :func:`cherrypicker.mvs.kernels.matching.prepare_patch`.
    """

    patch: np.ndarray
    costs: np.ndarray
    top: np.ndarray
    found: np.ndarray
    order: np.ndarray
    pixels: np.ndarray


def over_rows(function, level: Level, threads: int, *arguments) -> None:
    """Call a kernel for blocks of the level's rows, on some threads."""

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
        function(level, first, min(first + ROWS_AT_A_TIME, level.height), *arguments, scratch)

    in_parallel(work, range(0, level.height, ROWS_AT_A_TIME), threads)
