"""Geometric consistency: what the sources' depth maps say about a reference's, and the filter."""

from __future__ import annotations

import numpy as np

from cherrypicker.mvs.kernels.compiled import in_parallel, kernel
from cherrypicker.mvs.kernels.hypothesis import improve, load_top, prepare, store_top
from cherrypicker.mvs.kernels.level import over_rows
from cherrypicker.mvs.kernels.matching import geometric_error, source_cost

_0 = np.float32(0.0)
_HALF = np.float32(0.5)


@kernel
def _splat_source(level, s, splat):
    back = level.back
    base = level.layout[s, 0]
    width = level.layout[s, 1]
    for v in range(level.layout[s, 2]):
        fv = np.float32(v)
        for u in range(width):
            found = level.depth[base + v * width + u]
            if found <= _0:
                continue
            fu = np.float32(u)
            z = back[s, 6] * fu + back[s, 7] * fv + back[s, 8] + back[s, 11] * found
            if z <= np.float32(1e-6):
                continue
            x = (back[s, 0] * fu + back[s, 1] * fv + back[s, 2] + back[s, 9] * found) / z
            y = (back[s, 3] * fu + back[s, 4] * fv + back[s, 5] + back[s, 10] * found) / z
            ix = np.int64(np.floor(x + _HALF))
            iy = np.int64(np.floor(y + _HALF))
            if ix >= 0 and iy >= 0 and ix < level.width and iy < level.height:
                splat[s, iy, ix] = max(splat[s, iy, ix], found / z)


def splat_sources(level, splat, threads=1):
    """Draw every source's depth map into the reference, the nearest point of each pixel.

    Parameters
    ----------
    level : Level
        With the sources' inverse depth maps.
    splat : ndarray of shape (n_sources, height, width), float32
        Filled with inverse depth in the reference; must be zero before.
    """
    in_parallel(lambda s: _splat_source(level, s, splat), range(len(level.layout)), threads)


@kernel
def _adopt_rows(level, first, last, field, chosen, active, splat, min_step_px, scratch):
    patch = scratch.patch
    costs = scratch.costs
    top = scratch.top
    min_step = min_step_px * level.w_px
    for y in range(first, last):
        for x in range(level.width):
            if active[y, x] == 0:
                continue
            variance = np.float32(-1.0)
            load_top(chosen, x, y, top)
            for s in range(level.layout.shape[0]):
                w = splat[s, y, x]
                if w < level.w_min or w > level.w_max or abs(w - field[y, x, 0]) < min_step:
                    continue
                if variance < _0:
                    variance = prepare(level, x, y, scratch)
                cost = improve(level, x, y, w, _0, _0, patch, variance, costs, top, field[y, x, 3])
                if cost < field[y, x, 3]:
                    field[y, x, 0] = w
                    field[y, x, 1] = _0
                    field[y, x, 2] = _0
                    field[y, x, 3] = cost
            store_top(chosen, x, y, top)


def adopt_from_sources(level, field, chosen, active, splat, min_step_px, threads=1):
    """Try at every pixel the depths that the sources' maps put there.

    Only those more than ``min_step_px`` of parallax away from what the pixel holds: this carries
    twigs that one photo found over to those that missed them.
    """
    over_rows(_adopt_rows, level, threads, field, chosen, active, splat, min_step_px)


@kernel
def _count_rows(level, first, last, field, counts, enough, max_cost, max_error_px, scratch):
    for y in range(first, last):
        for x in range(level.width):
            counts[y, x] = 0
            w = field[y, x, 0]
            if w <= _0:
                continue
            variance = prepare(level, x, y, scratch)
            fx = np.float32(x)
            fy = np.float32(y)
            n = 0
            for s in range(level.layout.shape[0]):
                error = geometric_error(
                    level.depth, level.layout, level.project, level.back, s, fx, fy, w
                )
                if error > max_error_px:
                    continue
                cost = source_cost(
                    level.packed, level.layout, level.project, s, fx, fy,
                    w, field[y, x, 1], field[y, x, 2], level.radius, scratch.patch, variance,
                )  # fmt: skip
                if cost < max_cost:
                    n += 1
                    if n == enough:
                        break
            counts[y, x] = n


def count_consistent(level, field, counts, enough, max_cost, max_error_px, threads=1):
    """Count the sources that agree with every pixel in colour and in depth.

    Parameters
    ----------
    counts : ndarray of shape (height, width), uint8
        Filled with the number of sources whose 1 - NCC is below ``max_cost`` and whose own map
        brings the pixel back within ``max_error_px``; nobody looks for more than ``enough``.
    """
    over_rows(_count_rows, level, threads, field, counts, enough, max_cost, max_error_px)
