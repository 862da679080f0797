"""Where PatchMatch starts from at a pyramid level: random depths, or the level above."""

import numpy as np

from cherrypicker.compiled import Num
from cherrypicker.mvs.kernels.hash_random import DRAWS_A_PIXEL, uniform
from cherrypicker.mvs.kernels.hypothesis import evaluate, improve, load_top, store, store_top
from cherrypicker.mvs.kernels.level import Level, Scratch, State, by_rows
from cherrypicker.mvs.kernels.matching import INVALID_COST, prepare

_0 = np.float32(0.0)
# Random hypotheses of a pixel at the coarsest level, of which the sweeps carry the good ones on
# (guess)
N_RANDOM = 6
# Those at a sparse point lie between so much of its inverse depth and as much more (guess)
PRIOR_LEAST, PRIOR_SPREAD = np.float32(0.9), np.float32(0.2)
# Coarse pixels of the four around a pixel whose hypotheses are tried (guess)
N_COARSE = 2
# Colour distance of a coarse pixel that has no depth, cost of no hypothesis: above all others
_UNKNOWN = np.float32(1e9)


@by_rows
def find_texture(
    level: Level, first: Num, last: Num, active: np.ndarray, min_variance: Num, scratch: Scratch
) -> None:
    """Mark the pixels whose patch has texture; the others (clear sky, a wall) are skipped."""
    for y in range(first, last):
        for x in range(level.width):
            if active[y, x] != 0 and prepare(level, x, y, scratch) < min_variance:
                active[y, x] = 0


@by_rows
def start_randomly(
    level: Level,
    first: Num,
    last: Num,
    state: State,
    prior: np.ndarray,
    seed: Num,
    scratch: Scratch,
) -> None:
    """Give every active pixel the best of some random hypotheses.

    Every second one takes the inverse depth of a sparse point near by (``prior``) and spreads
    around it, the others are uniform in inverse depth; slopes are small.
    """
    field, chosen, active = state.field, state.chosen, state.active
    for y in range(first, last):
        for x in range(level.width):
            if active[y, x] == 0:
                continue
            variance = prepare(level, x, y, scratch)
            pixel = np.uint64(seed) + np.uint64(y * level.width + x) * DRAWS_A_PIXEL
            best = _UNKNOWN
            for trial in range(N_RANDOM):
                draw = 4 * trial
                w = level.w_min + (level.w_max - level.w_min) * uniform(pixel, draw)
                if trial % 2 == 1:
                    w = prior[y, x] * (PRIOR_LEAST + PRIOR_SPREAD * uniform(pixel, draw))
                w = min(max(w, level.w_min), level.w_max)
                gx = (uniform(pixel, draw + 1) - np.float32(0.5)) * w / level.fx
                gy = (uniform(pixel, draw + 2) - np.float32(0.5)) * w / level.fy
                cost = evaluate(level, x, y, w, gx, gy, variance, scratch)
                if cost < best:
                    best = cost
                    store(field, y, x, w, gx, gy, cost)
                    store_top(chosen, x, y, scratch.top)


@by_rows
def start_from_coarse(
    level: Level,
    first: Num,
    last: Num,
    state: State,
    coarse: State,
    coarse_color: np.ndarray,
    scratch: Scratch,
) -> None:
    """Start a level from the one above: the best of the nearest coarse pixels' hypotheses.

    Of the four coarse pixels around a pixel the ones of the most similar colour are tried, so that
    a branch does not inherit the background's depth across its silhouette.
    """
    field, chosen, active = state.field, state.chosen, state.active
    above, top, order = coarse.field, scratch.top, scratch.order
    height, width = above.shape[0], above.shape[1]
    step_x = np.float32(width) / np.float32(level.width)
    step_y = np.float32(height) / np.float32(level.height)
    for y in range(first, last):
        for x in range(level.width):
            if active[y, x] == 0:
                continue
            variance = prepare(level, x, y, scratch)
            cx = (np.float32(x) + np.float32(0.5)) * step_x - np.float32(0.5)
            cy = (np.float32(y) + np.float32(0.5)) * step_y - np.float32(0.5)
            x0 = min(max(np.int64(np.floor(cx)), 0), width - 2)
            y0 = min(max(np.int64(np.floor(cy)), 0), height - 2)
            color = level.color[np.uint64(y * level.width + x)]
            for i in range(4):
                xi = x0 + (i & 1)
                yi = y0 + (i >> 1)
                order[i] = _UNKNOWN
                if above[yi, xi, 0] > _0:
                    other_color = coarse_color[np.uint64(yi * width + xi)]
                    order[i] = _0
                    for shift in range(0, 24, 8):  # red, green and blue
                        own = np.int64((color >> shift) & 255)
                        order[i] += np.float32(abs(own - np.int64((other_color >> shift) & 255)))
            best = np.float32(-1.0)
            for _ in range(N_COARSE):
                i = 0
                for other in range(1, 4):
                    if order[other] < order[i]:
                        i = other
                if order[i] >= _UNKNOWN and best >= _0:
                    break
                xi = x0 + (i & 1)
                yi = y0 + (i >> 1)
                gx = _0
                gy = _0
                w = np.float32(0.5) * (level.w_min + level.w_max)
                if order[i] < _UNKNOWN:
                    order[i] = _UNKNOWN
                    gx = above[yi, xi, 1] * step_x
                    gy = above[yi, xi, 2] * step_y
                    w = above[yi, xi, 0]
                    w += above[yi, xi, 1] * (cx - np.float32(xi))
                    w += above[yi, xi, 2] * (cy - np.float32(yi))
                    w = min(max(w, level.w_min), level.w_max)
                    if best < _0:
                        load_top(coarse.chosen, xi, yi, top)
                        best = INVALID_COST + INVALID_COST
                cost = improve(level, x, y, w, gx, gy, variance, scratch, best)
                if cost < best or best < _0:
                    best = cost
                    store(field, y, x, w, gx, gy, cost)
            store_top(chosen, x, y, top)


@by_rows
def evaluate_field(level: Level, first: Num, last: Num, state: State, scratch: Scratch) -> None:
    """Recompute the cost of what every active pixel holds (the cost function has changed)."""
    field, chosen, active = state.field, state.chosen, state.active
    for y in range(first, last):
        for x in range(level.width):
            if active[y, x] == 0 or field[y, x, 0] <= _0:
                field[y, x, 3] = INVALID_COST
                continue
            variance = prepare(level, x, y, scratch)
            w, gx, gy = field[y, x, 0], field[y, x, 1], field[y, x, 2]
            field[y, x, 3] = evaluate(level, x, y, w, gx, gy, variance, scratch)
            store_top(chosen, x, y, scratch.top)
