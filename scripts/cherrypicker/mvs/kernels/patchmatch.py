"""PatchMatch over one pyramid level: checkerboard propagation and refinement.

Red pixels are updated from black ones and the other way round, so rows run in parallel and the
result does not depend on their order; every random number is a hash of seed, pixel and sweep.
"""

from typing import NamedTuple

import numpy as np

from cherrypicker.compiled import Num, inlined
from cherrypicker.mvs.kernels.hash_random import DRAWS_A_PIXEL, uniform
from cherrypicker.mvs.kernels.hypothesis import improve, load_top, store, store_top
from cherrypicker.mvs.kernels.level import Level, Scratch, State, by_rows
from cherrypicker.mvs.kernels.matching import INVALID_COST, most_bend, prepare

_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
# A hypothesis that costs more is wrong for its own pixel and no help to others (guess)
HOPELESS_COST = np.float32(0.9)
# Steps of refinement, px of parallax; each stands for the octave above it (guess)
STEPS_PX = np.array([0.125, 0.25, 0.5, 1.0, 2.0, 4.0], dtype=np.float32)
# Propagation: three pixels of the other colour in each of four directions, near by and far
# (ACMH, Xu and Tao, CVPR 2019, takes eight regions of the like)
NEIGHBORS = np.array(
    [
        [[0, -1], [-1, -2], [1, -2]],
        [[0, 1], [-1, 2], [1, 2]],
        [[-1, 0], [-2, -1], [-2, 1]],
        [[1, 0], [2, -1], [2, 1]],
        [[0, -5], [0, -9], [0, -17]],
        [[0, 5], [0, 9], [0, 17]],
        [[-5, 0], [-9, 0], [-17, 0]],
        [[5, 0], [9, 0], [17, 0]],
    ],
    dtype=np.int64,
)
N_NEAR = 4


class Turn(NamedTuple):
    """What a pixel tries when it is its turn."""

    n_near: int  # most hypotheses of neighbours
    n_refine: int  # changes of its own
    n_random: int = 0  # new depths from the whole range
    # A pixel that costs more is not refined: its depth is wrong, and a small step will not do
    refine_below: np.float32 = INVALID_COST


@inlined
def _collect(level: Level, field: np.ndarray, x: Num, y: Num, most: Num, found: np.ndarray) -> Num:
    """List the neighbours whose hypotheses are worth a try: four near ones, then far ones."""
    n = 0
    for direction in range(NEIGHBORS.shape[0]):
        if direction >= N_NEAR and n >= most:
            break
        best = HOPELESS_COST
        for i in range(NEIGHBORS.shape[1]):
            nx = x + NEIGHBORS[direction, i, 0]
            ny = y + NEIGHBORS[direction, i, 1]
            if (
                nx >= 0 and ny >= 0 and nx < level.width and ny < level.height
                and field[ny, nx, 0] > _0 and field[ny, nx, 3] < best
            ):  # fmt: skip
                best = field[ny, nx, 3]
                found[n, 0] = nx
                found[n, 1] = ny
        if best < HOPELESS_COST:
            n += 1
    return min(n, most)


@inlined
def _change(
    level: Level, w: Num, gx: Num, gy: Num, pixel: Num, i: Num, n_refine: Num
) -> tuple[Num, Num, Num]:
    """Return the ``i``-th random change of a hypothesis, a new depth from ``n_refine`` on."""
    draw = 8 * i
    if i >= n_refine:
        return level.w_min + (level.w_max - level.w_min) * uniform(pixel, draw), _0, _0
    kind = i % 3
    if kind != 1:
        octaves = np.float32(STEPS_PX.shape[0]) * uniform(pixel, draw)
        octave = np.int64(octaves)
        step = STEPS_PX[octave] * (_1 + octaves - np.float32(octave))
        w += level.w_px * step * (_2 * uniform(pixel, draw + 1) - _1)
    if kind != 0:
        bend = uniform(pixel, draw + 2)
        bend = _2 * bend * bend * w
        gx += bend / level.fx * (_2 * uniform(pixel, draw + 3) - _1)
        gy += bend / level.fy * (_2 * uniform(pixel, draw + 4) - _1)
    return w, gx, gy


@by_rows
def sweep(
    level: Level,
    first: Num,
    last: Num,
    state: State,
    parity: Num,
    turn: Turn,
    seed: Num,
    scratch: Scratch,
) -> None:
    """Update the pixels of one colour of the checkerboard.

    Each tries the hypotheses of up to ``turn.n_near`` neighbours, moved along their planes, then
    ``n_refine`` changes of its own (a step of 1/8 to 8 pixels of parallax, of the slopes, or both;
    on what bends half its radius to the front takes the place of the first) and ``n_random`` new
    depths from the whole range.
    """
    field, chosen, active = state.field, state.chosen, state.active
    top, found = scratch.top, scratch.found
    for y in range(first, last):
        for x in range((y + parity) & 1, level.width, 2):
            if active[y, x] == 0:
                continue
            variance = prepare(level, x, y, scratch)
            w = field[y, x, 0]
            gx = field[y, x, 1]
            gy = field[y, x, 2]
            best = field[y, x, 3]
            load_top(chosen, x, y, top)
            n = _collect(level, field, x, y, turn.n_near, found)
            pixel = np.uint64(seed) + np.uint64(y * level.width + x) * DRAWS_A_PIXEL
            n_tries = n + turn.n_refine + turn.n_random
            for i in range(n_tries):
                if i < n:
                    nx = found[i, 0]
                    ny = found[i, 1]
                    tx = field[ny, nx, 1]
                    ty = field[ny, nx, 2]
                    tw = field[ny, nx, 0] + tx * np.float32(x - nx) + ty * np.float32(y - ny)
                elif i < n + turn.n_refine and best > turn.refine_below:
                    continue
                elif i == n and most_bend(level, x, y) > _0:
                    # What was matched flat, at a level above, lies behind the front of round wood
                    tw, tx, ty = w + most_bend(level, x, y), gx, gy
                else:
                    tw, tx, ty = _change(level, w, gx, gy, pixel, i - n, turn.n_refine)
                if tw < level.w_min or tw > level.w_max:
                    continue
                cost = improve(level, x, y, tw, tx, ty, variance, scratch, best)
                if cost < best:
                    best = cost
                    w = tw
                    gx = tx
                    gy = ty
            store(field, y, x, w, gx, gy, best)
            store_top(chosen, x, y, top)
