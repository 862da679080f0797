"""Geometric consistency: what the sources' depth maps say about a reference's, and the filter."""

import numpy as np

from cherrypicker.compiled import Num, in_parallel, kernel
from cherrypicker.mvs.kernels.hypothesis import improve, load_top, store, store_top
from cherrypicker.mvs.kernels.level import Level, Scratch, State, by_rows
from cherrypicker.mvs.kernels.matching import geometric_error, prepare, source_cost
from cherrypicker.mvs.kernels.projection import BEHIND, depth_in, pixel_at, pixel_in

_0 = np.float32(0.0)


@kernel
def _splat_source(level: Level, s: Num, splat: np.ndarray) -> None:
    base = level.layout[s, 0]
    width = level.layout[s, 1]
    for v in range(level.layout[s, 2]):
        for u in range(width):
            found = level.depth[base + v * width + u]
            if found <= _0:
                continue
            fu = np.float32(u)
            fv = np.float32(v)
            z = depth_in(level.back, s, fu, fv, found)
            if z <= BEHIND:
                continue
            x, y = pixel_in(level.back, s, fu, fv, found, z)
            ix = pixel_at(x)
            iy = pixel_at(y)
            if ix >= 0 and iy >= 0 and ix < level.width and iy < level.height:
                splat[s, iy, ix] = max(splat[s, iy, ix], found / z)


def splat_sources(level: Level, threads: int) -> np.ndarray:
    """Draw every source's depth map into the reference, the nearest point of each pixel.

    Inverse depths in the reference, (n_sources, height, width) float32, 0 where nothing falls.
    """
    splat = np.zeros((len(level.layout), level.height, level.width), dtype=np.float32)
    in_parallel(lambda s: _splat_source(level, s, splat), range(len(level.layout)), threads)
    return splat


@by_rows
def adopt_from_sources(
    level: Level, first: Num, last: Num, state: State, splat: np.ndarray, scratch: Scratch
) -> None:
    """Try at every pixel the depths that the sources' maps put there.

    This carries twigs that one photo found over to those that missed them.
    """
    field, chosen, active = state.field, state.chosen, state.active
    for y in range(first, last):
        for x in range(level.width):
            if active[y, x] == 0:
                continue
            variance = np.float32(-1.0)
            load_top(chosen, x, y, scratch.top)
            for s in range(level.layout.shape[0]):
                w = splat[s, y, x]
                if w < level.w_min or w > level.w_max:
                    continue
                if variance < _0:
                    variance = prepare(level, x, y, scratch)
                cost = improve(level, x, y, w, _0, _0, variance, scratch, field[y, x, 3])
                if cost < field[y, x, 3]:
                    store(field, y, x, w, _0, _0, cost)
            store_top(chosen, x, y, scratch.top)


@by_rows
def drop_inconsistent(
    level: Level,
    first: Num,
    last: Num,
    field: np.ndarray,
    enough: Num,
    max_cost: Num,
    max_error_px: Num,
    scratch: Scratch,
) -> None:
    """Set to 0 the pixels of a field that less than ``enough`` sources confirm.

    Their 1 - NCC is to be below ``max_cost``, and their own map is to bring the pixel back within
    ``max_error_px``.
    """
    for y in range(first, last):
        for x in range(level.width):
            w, gx, gy = field[y, x, 0], field[y, x, 1], field[y, x, 2]
            if w <= _0:
                continue
            variance = prepare(level, x, y, scratch)
            fx = np.float32(x)
            fy = np.float32(y)
            n = 0
            for s in range(level.layout.shape[0]):
                if geometric_error(level, s, fx, fy, w) > max_error_px:
                    continue
                if source_cost(level, s, fx, fy, w, gx, gy, variance, scratch.patch) < max_cost:
                    n += 1
                    if n == enough:
                        break
            if n < enough:
                store(field, y, x, _0, _0, _0, _0)
