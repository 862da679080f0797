"""What the kernels of PatchMatch work on: a reference and its sources at one pyramid level.

A field is an array (height, width, 4) float32 of inverse depth, its slopes along x and y per pixel,
and the cost.
"""

from collections.abc import Callable
from functools import wraps
from typing import NamedTuple

import numpy as np

from cherrypicker.compiled import in_parallel, kernel

# Samples of a patch; a multiple of the vector width, unused ones get weight zero
N_SAMPLES = 32
# Rows that a thread takes at a time
ROWS_AT_A_TIME = 16


class Level(NamedTuple):
    """One reference and its sources at one pyramid level, as the kernels take them."""

    # (height * width,) int32: the reference, packed by
    # :func:`cherrypicker.mvs.kernels.matching.pack_color`
    color: np.ndarray
    # width, height: its size
    width: int
    height: int
    samples: np.ndarray  # (3, 32) float32: the window
    offsets: np.ndarray  # (32,) int64: its samples' places in ``color``, from the centre
    radius: np.float32  # its radius, px
    inv_color: np.float32  # 1 / (squared colour distance at which a pixel counts half)
    # packed, layout, project: all sources' pixels, packed, one after the other; (n, 3) where each
    # begins, its width and height; (n, 12) matrix A by rows and vector b
    packed: np.ndarray
    layout: np.ndarray
    project: np.ndarray
    # depth, back: the sources' inverse depth maps and the way back, for the geometric cost
    depth: np.ndarray
    back: np.ndarray
    n_best: int  # how many of the sources' costs, lowest first, make the cost
    # What one pixel of inconsistency costs; 0 without the sources' maps
    geometric_weight: np.float32
    # w_min, w_max: range of inverse depth
    w_min: np.float32
    w_max: np.float32
    w_px: np.float32  # inverse depth that makes one pixel of parallax in a middling source
    # fx, fy, cx, cy: focal lengths and principal point of the reference at this level, px
    fx: np.float32
    fy: np.float32
    cx: np.float32
    cy: np.float32
    # (height, width, 3) float32, or (0, 0, 3) where all is flat: by how much the wood at a pixel
    # bends away from its tangent plane, in inverse depth. At (dx, dy) from it that is the smaller
    # of ``(bend[0] * dx + bend[1] * dy) ** 2`` and ``bend[2]``, which is half the radius.
    bend: np.ndarray


class State(NamedTuple):
    """What the pixels of a level hold."""

    field: np.ndarray  # (height, width, 4) float32: their hypotheses and costs
    chosen: np.ndarray  # (height, width) uint16: their best sources, four bits each
    active: np.ndarray  # (height, width) uint8: whether they are worked on


class Scratch(NamedTuple):
    """A thread's working memory."""

    # (6, 32) float32: offsets and spatial weights of `Level.samples`, then the bilateral weights,
    # centred, weighted grey values and bends of the pixel at hand
    patch: np.ndarray
    costs: np.ndarray  # (n_sources,) float32
    top: np.ndarray  # (n_best,) int64: the pixel's best sources
    found: np.ndarray  # (8, 2) int64: neighbours worth a try
    order: np.ndarray  # (4,) float32: colour distances of coarse pixels
    pixels: np.ndarray  # (32,) int32: packed colours of the patch


def by_rows(function: Callable[..., None]) -> Callable[..., None]:
    """Compile a kernel of some rows of a level, to be called for all of them.

    The kernel takes the level, its first row and the one after its last, arguments of its own and a
    `Scratch`. A caller gives the level, the number of threads and the arguments.
    """
    rows = kernel(function)

    @wraps(function)
    def over_rows(level: Level, threads: int, *arguments: object) -> None:
        def work(first: int) -> None:
            patch = np.zeros((6, N_SAMPLES), dtype=np.float32)
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
