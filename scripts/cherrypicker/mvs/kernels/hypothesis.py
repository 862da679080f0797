"""What a hypothesis costs: the mean over the sources that suit it best.

A hypothesis at a pixel is its inverse depth and the slopes of that along x and y.
"""

import numpy as np

from cherrypicker.compiled import Num, inlined
from cherrypicker.mvs.kernels.level import Level, Scratch
from cherrypicker.mvs.kernels.matching import INVALID_COST, geometric_error, source_cost

_0 = np.float32(0.0)
# When a hypothesis is given up after some of the best sources: their sum exceeds as many times the
# present mean by SCREEN_MARGIN, or once all are asked by LAST_MARGIN. While the present one is no
# match itself (above MATCH_COST) its best sources mean little, and only the whole sum counts
# (guesses).
SCREEN_MARGIN = np.float32(0.3)
LAST_MARGIN = np.float32(0.06)
MATCH_COST = np.float32(0.75)


@inlined
def evaluate(
    level: Level, x: Num, y: Num, w: Num, gx: Num, gy: Num, variance: Num, scratch: Scratch
) -> Num:
    """Return a hypothesis' cost, the mean of its best sources', named in ``scratch.top``."""
    return improve(level, x, y, w, gx, gy, variance, scratch, np.float32(-1.0))


@inlined
def improve(
    level: Level,
    x: Num,
    y: Num,
    w: Num,
    gx: Num,
    gy: Num,
    variance: Num,
    scratch: Scratch,
    best: Num,
) -> Num:
    """Return a hypothesis' cost, or a bound of it where it cannot beat ``best``.

    The sources that suit the pixel's present hypothesis (``scratch.top``) are asked first. Their
    mean is an upper bound of the cost: below ``best`` it will do; far above, the others are not
    asked. In between all are, and ``top`` changes with them if the hypothesis is better. With a
    negative ``best`` all sources are asked and ``top`` is set.
    """
    costs, top = scratch.costs, scratch.top
    n = level.layout.shape[0]
    n_best = top.shape[0]
    fx = np.float32(x)
    fy = np.float32(y)
    screened = best >= _0
    limit = _0
    total = _0
    for s in range(n):
        costs[s] = np.float32(-1.0)
    for i in range(n_best + n if screened else n):
        s = i
        if screened:
            s = top[i] if i < n_best else i - n_best
            if costs[s] >= _0:
                continue
            limit = best * np.float32(n_best) + LAST_MARGIN
            if i < n_best - 1 and best < MATCH_COST:
                limit = best * np.float32(i + 1) + SCREEN_MARGIN
        cost = _0
        if level.geometric_weight > _0:
            cost = level.geometric_weight * geometric_error(level, s, fx, fy, w)
            # The cheap part first: it often decides already
            if screened and i < n_best and total + cost > limit:
                return INVALID_COST + INVALID_COST
        cost += source_cost(level, s, fx, fy, w, gx, gy, variance, scratch.patch)
        costs[s] = cost
        if screened and i < n_best:
            total += cost
            if total > limit:
                return INVALID_COST + INVALID_COST
            if i == n_best - 1 and total < best * np.float32(n_best):
                return total / np.float32(n_best)
    total = _0
    for _ in range(n_best):
        lowest = 0
        for s in range(1, n):
            if costs[s] < costs[lowest]:
                lowest = s
        total += costs[lowest]
        costs[lowest] += np.float32(100.0)
    mean = total / np.float32(n_best)
    if mean < best or not screened:
        i = 0
        for s in range(n):
            if costs[s] >= np.float32(100.0):
                top[i] = s
                i += 1
    return mean


@inlined
def load_top(chosen: np.ndarray, x: Num, y: Num, top: Num) -> None:
    """Unpack the pixel's best sources, four bits each."""
    word = np.int64(chosen[y, x])
    for i in range(top.shape[0]):
        top[i] = (word >> (4 * i)) & 15


@inlined
def store_top(chosen: np.ndarray, x: Num, y: Num, top: Num) -> None:
    """Pack the pixel's best sources, four bits each."""
    word = np.int64(0)
    for i in range(top.shape[0]):
        word |= top[i] << (4 * i)
    chosen[y, x] = word


@inlined
def store(field: np.ndarray, y: Num, x: Num, w: Num, gx: Num, gy: Num, cost: Num) -> None:
    """Write a hypothesis and its cost to a pixel of a field."""
    field[y, x, 0] = w
    field[y, x, 1] = gx
    field[y, x, 2] = gy
    field[y, x, 3] = cost
