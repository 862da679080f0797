"""Where PatchMatch starts from at a pyramid level: random depths, or the level above."""

from __future__ import annotations

import numpy as np

from cherrypicker.mvs.kernels.compiled import inlined, kernel
from cherrypicker.mvs.kernels.hash_random import uniform
from cherrypicker.mvs.kernels.hypothesis import (
    evaluate,
    improve,
    load_top,
    prepare,
    store,
    store_top,
)
from cherrypicker.mvs.kernels.level import over_rows
from cherrypicker.mvs.kernels.matching import INVALID_COST

_0 = np.float32(0.0)
_HALF = np.float32(0.5)
# Colour distance of a coarse pixel that has no depth
_UNKNOWN = np.float32(1e9)


@kernel
def _texture_rows(level, first, last, active, min_variance, scratch):
    for y in range(first, last):
        for x in range(level.width):
            if active[y, x] == 0:
                continue
            variance = prepare(level, x, y, scratch)
            if variance < min_variance:
                active[y, x] = 0


def find_texture(level, active, min_variance, threads=1):
    """Mark the pixels whose patch has texture; the others (clear sky, a wall) are skipped."""
    over_rows(_texture_rows, level, threads, active, min_variance)


@kernel
def _random_rows(level, first, last, field, chosen, active, prior, n_trials, seed, scratch):
    patch = scratch.patch
    costs = scratch.costs
    top = scratch.top
    for y in range(first, last):
        for x in range(level.width):
            if active[y, x] == 0:
                continue
            variance = prepare(level, x, y, scratch)
            pixel = np.uint64(seed) + np.uint64(y * level.width + x) * np.uint64(4096)
            best = np.float32(1e9)
            for trial in range(n_trials):
                draw = 4 * trial
                w = level.w_min + (level.w_max - level.w_min) * uniform(pixel, draw)
                if trial % 2 == 1 and prior[y, x] > _0:
                    w = prior[y, x] * (np.float32(0.9) + np.float32(0.2) * uniform(pixel, draw))
                w = min(max(w, level.w_min), level.w_max)
                gx = (uniform(pixel, draw + 1) - _HALF) * w / level.fx
                gy = (uniform(pixel, draw + 2) - _HALF) * w / level.fy
                cost = evaluate(level, x, y, w, gx, gy, patch, variance, costs, top)
                if cost < best:
                    best = cost
                    store(field, y, x, w, gx, gy, cost)
                    store_top(chosen, x, y, top)


def start_randomly(level, field, chosen, active, prior, n_trials, seed, threads=1):
    """Give every active pixel the best of some random hypotheses.

    Every second one takes the inverse depth of a sparse point near by (``prior``, 0 where there is
    none) and spreads around it, the others are uniform in inverse depth; slopes are small.
    """
    over_rows(_random_rows, level, threads, field, chosen, active, prior, n_trials, seed)


@inlined
def _nearest_coarse(level, coarse, coarse_color, x, y, cx, cy, order):
    """Rate the four coarse pixels around (cx, cy) by likeness of colour; return their origin."""
    width = coarse.shape[1]
    x0 = min(max(np.int64(np.floor(cx)), 0), width - 2)
    y0 = min(max(np.int64(np.floor(cy)), 0), coarse.shape[0] - 2)
    own = level.color[np.uint64(y * level.width + x)]
    for i in range(4):
        xi = x0 + (i & 1)
        yi = y0 + (i >> 1)
        order[i] = _UNKNOWN
        if coarse[yi, xi, 0] > _0:
            order[i] = _color_distance(own, coarse_color[np.uint64(yi * width + xi)])
    return x0, y0


@kernel
def _coarse_rows(
    level,
    first,
    last,
    field,
    chosen,
    active,
    coarse,
    coarse_color,
    coarse_chosen,
    n_trials,
    scratch,
):
    patch = scratch.patch
    costs = scratch.costs
    top = scratch.top
    order = scratch.order
    step_x = np.float32(coarse.shape[1]) / np.float32(level.width)
    step_y = np.float32(coarse.shape[0]) / np.float32(level.height)
    for y in range(first, last):
        for x in range(level.width):
            if active[y, x] == 0:
                continue
            variance = prepare(level, x, y, scratch)
            cx = (np.float32(x) + _HALF) * step_x - _HALF
            cy = (np.float32(y) + _HALF) * step_y - _HALF
            x0, y0 = _nearest_coarse(level, coarse, coarse_color, x, y, cx, cy, order)
            best = np.float32(-1.0)
            for _ in range(n_trials):
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
                w = _HALF * (level.w_min + level.w_max)
                if order[i] < _UNKNOWN:
                    order[i] = _UNKNOWN
                    gx = coarse[yi, xi, 1] * step_x
                    gy = coarse[yi, xi, 2] * step_y
                    w = coarse[yi, xi, 0]
                    w += coarse[yi, xi, 1] * (cx - np.float32(xi))
                    w += coarse[yi, xi, 2] * (cy - np.float32(yi))
                    w = min(max(w, level.w_min), level.w_max)
                    if best < _0:
                        load_top(coarse_chosen, xi, yi, top)
                        best = INVALID_COST + INVALID_COST
                cost = improve(level, x, y, w, gx, gy, patch, variance, costs, top, best)
                if cost < best or best < _0:
                    best = cost
                    store(field, y, x, w, gx, gy, cost)
            store_top(chosen, x, y, top)


def start_from_coarse(
    level, field, chosen, active, coarse, coarse_color, coarse_chosen, n_trials, threads=1
):
    """Start a level from the one above: the best of the nearest coarse pixels' hypotheses.

    Of the four coarse pixels around a pixel the ones of the most similar colour are tried, so that
    a branch does not inherit the background's depth across its silhouette.
    """
    over_rows(
        _coarse_rows,
        level,
        threads,
        field,
        chosen,
        active,
        coarse,
        coarse_color,
        coarse_chosen,
        n_trials,
    )


@inlined
def _color_distance(a, b):
    red = abs(np.int64(a & 255) - np.int64(b & 255))
    green = abs(np.int64((a >> 8) & 255) - np.int64((b >> 8) & 255))
    blue = abs(np.int64((a >> 16) & 255) - np.int64((b >> 16) & 255))
    return np.float32(red + green + blue)


@kernel
def _evaluate_rows(level, first, last, field, chosen, active, scratch):
    patch = scratch.patch
    costs = scratch.costs
    top = scratch.top
    for y in range(first, last):
        for x in range(level.width):
            if active[y, x] == 0 or field[y, x, 0] <= _0:
                field[y, x, 3] = INVALID_COST
                continue
            variance = prepare(level, x, y, scratch)
            field[y, x, 3] = evaluate(
                level, x, y, field[y, x, 0], field[y, x, 1], field[y, x, 2],
                patch, variance, costs, top,
            )  # fmt: skip
            store_top(chosen, x, y, top)


def evaluate_field(level, field, chosen, active, threads=1):
    """Recompute the cost of what every active pixel holds (the cost function has changed)."""
    over_rows(_evaluate_rows, level, threads, field, chosen, active)
