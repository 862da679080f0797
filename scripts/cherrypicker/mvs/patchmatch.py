"""PatchMatch over one pyramid level: random start, checkerboard propagation, refinement.

A field is an array (height, width, 4) float32 of inverse depth, its slopes along x and y per pixel,
and the cost. Red pixels are updated from black ones and the other way round, so rows run in
parallel and the result does not depend on their order; every random number is a hash of seed,
pixel and sweep.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cherrypicker.mvs.compiled import in_parallel, kernel
from cherrypicker.mvs.matching import (
    INVALID_COST,
    N_SAMPLES,
    geometric_error,
    prepare_patch,
    source_cost,
)

_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
_HALF = np.float32(0.5)
# Colour distance of a coarse pixel that has no depth
_UNKNOWN = np.float32(1e9)
# Steepest plane: tangent of the angle between its normal and the optical axis
MAX_SLOPE = np.float32(4.0)
# Hypotheses nearer than this (px of parallax over the window) to the present one are not tried
SAME_PX = np.float32(0.06)
# A hypothesis that costs more is wrong for its own pixel and no help to others
HOPELESS_COST = np.float32(0.9)
# Rows that a thread takes at a time
ROWS_AT_A_TIME = 16
# When a hypothesis is given up after some of the best sources: their sum exceeds as many times the
# present mean by SCREEN_MARGIN, or once all are asked by LAST_MARGIN. While the present one is no
# match itself (above MATCH_COST) its best sources mean little, and only the whole sum counts.
SCREEN_MARGIN = np.float32(0.3)
LAST_MARGIN = np.float32(0.06)
MATCH_COST = np.float32(0.75)
# Distances of far propagation; odd, so that they reach the other colour of the checkerboard
FAR_STEPS = np.array([5, 9, 17], dtype=np.int64)
# Steps of refinement, px of parallax; each stands for the octave above it
STEPS_PX = np.array([0.125, 0.25, 0.5, 1.0, 2.0, 4.0], dtype=np.float32)
# Near propagation: three pixels of the other colour in each of four directions
NEAR = np.array(
    [
        [[0, -1], [-1, -2], [1, -2]],
        [[0, 1], [-1, 2], [1, 2]],
        [[-1, 0], [-2, -1], [-2, 1]],
        [[1, 0], [2, -1], [2, 1]],
    ],
    dtype=np.int64,
)


class Level(NamedTuple):
    """One reference and its sources at one pyramid level, as the kernels take them.

    Attributes
    ----------
    color : ndarray of shape (height * width,), int32
        The reference, packed by :func:`cherrypicker.mvs.matching.pack_color`.
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
    fx, fy : float32
        Focal lengths of the reference at this level, px.
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


class Turn(NamedTuple):
    """What a pixel tries when it is its turn.

    Attributes
    ----------
    n_near, n_refine, n_random : int
        Most hypotheses of neighbours; changes of its own; new depths from the whole range.
    refine_below : float32
        A pixel that costs more is not refined: its depth is wrong, and a small step will not do.
    """

    n_near: int
    n_refine: int
    n_random: int
    refine_below: np.float32


class Scratch(NamedTuple):
    """A thread's working memory.

    Attributes
    ----------
    patch : ndarray of shape (5, 32), float32
        See :func:`cherrypicker.mvs.matching.prepare_patch`.
    costs : ndarray of shape (n_sources,), float32
    top : ndarray of shape (n_best,), int64
        The pixel's best sources.
    found : ndarray of shape (8, 2), int64
        Neighbours worth a try.
    order : ndarray of shape (4,), float32
        Colour distances of coarse pixels.
    pixels : ndarray of shape (32,), int32
        See :func:`cherrypicker.mvs.matching.prepare_patch`.
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


@kernel
def _mix(state):
    z = state * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@kernel
def _uniform(seed, draw):
    """Return a float32 in [0, 1) that depends on seed and draw only."""
    bits = _mix(seed + np.uint64(draw)) >> np.uint64(40)
    return np.float32(bits) * np.float32(1.0 / 16777216.0)


@kernel
def _is_plausible(level, w, gx, gy):
    steep = MAX_SLOPE * w
    return (
        w >= level.w_min
        and w <= level.w_max
        and abs(gx) * level.fx <= steep
        and abs(gy) * level.fy <= steep
    )


@kernel
def evaluate(level, x, y, w, gx, gy, patch, variance, costs, top):
    """Return a hypothesis' cost, the mean of its best sources', and name these in ``top``."""
    return improve(level, x, y, w, gx, gy, patch, variance, costs, top, np.float32(-1.0))


@kernel
def improve(level, x, y, w, gx, gy, patch, variance, costs, top, best):
    """Return a hypothesis' cost, or a bound of it where it cannot beat ``best``.

    The sources that suit the pixel's present hypothesis (``top``) are asked first. Their mean is an
    upper bound of the cost: below ``best`` it will do; far above, the others are not asked. In
    between all are, and ``top`` changes with them if the hypothesis is better. With a negative
    ``best`` all sources are asked and ``top`` is set.
    """
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
            cost = level.geometric_weight * geometric_error(
                level.depth, level.layout, level.project, level.back, s, fx, fy, w
            )
            # The cheap part first: it often decides already
            if screened and i < n_best and total + cost > limit:
                return INVALID_COST + INVALID_COST
        cost += source_cost(
            level.packed,
            level.layout,
            level.project,
            s,
            fx,
            fy,
            w,
            gx,
            gy,
            level.radius,
            patch,
            variance,
        )
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


@kernel
def load_top(chosen, x, y, top):
    """Unpack the pixel's best sources, four bits each."""
    word = np.int64(chosen[y, x])
    for i in range(top.shape[0]):
        top[i] = (word >> (4 * i)) & 15


@kernel
def store_top(chosen, x, y, top):
    """Pack the pixel's best sources, four bits each."""
    word = np.int64(0)
    for i in range(top.shape[0]):
        word |= top[i] << (4 * i)
    chosen[y, x] = word


@kernel
def _texture_rows(level, first, last, active, min_variance, scratch):
    patch = scratch.patch
    for y in range(first, last):
        for x in range(level.width):
            if active[y, x] == 0:
                continue
            variance = prepare_patch(
                level.color, level.width, level.height, x, y, level.inv_color,
                level.offsets, level.radius, patch, scratch.pixels,
            )  # fmt: skip
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
            variance = prepare_patch(
                level.color, level.width, level.height, x, y, level.inv_color,
                level.offsets, level.radius, patch, scratch.pixels,
            )  # fmt: skip
            pixel = np.uint64(seed) + np.uint64(y * level.width + x) * np.uint64(4096)
            best = np.float32(1e9)
            for trial in range(n_trials):
                draw = 4 * trial
                w = level.w_min + (level.w_max - level.w_min) * _uniform(pixel, draw)
                if trial % 2 == 1 and prior[y, x] > _0:
                    w = prior[y, x] * (np.float32(0.9) + np.float32(0.2) * _uniform(pixel, draw))
                w = min(max(w, level.w_min), level.w_max)
                gx = (_uniform(pixel, draw + 1) - _HALF) * w / level.fx
                gy = (_uniform(pixel, draw + 2) - _HALF) * w / level.fy
                cost = evaluate(level, x, y, w, gx, gy, patch, variance, costs, top)
                if cost < best:
                    best = cost
                    _store(field, y, x, w, gx, gy, cost)
                    store_top(chosen, x, y, top)


def start_randomly(level, field, chosen, active, prior, n_trials, seed, threads=1):
    """Give every active pixel the best of some random hypotheses.

    Every second one takes the inverse depth of a sparse point near by (``prior``, 0 where there is
    none) and spreads around it, the others are uniform in inverse depth; slopes are small.
    """
    over_rows(_random_rows, level, threads, field, chosen, active, prior, n_trials, seed)


@kernel
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
            variance = prepare_patch(
                level.color, level.width, level.height, x, y, level.inv_color,
                level.offsets, level.radius, patch, scratch.pixels,
            )  # fmt: skip
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
                    _store(field, y, x, w, gx, gy, cost)
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


@kernel
def _store(field, y, x, w, gx, gy, cost):
    field[y, x, 0] = w
    field[y, x, 1] = gx
    field[y, x, 2] = gy
    field[y, x, 3] = cost


@kernel
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
            variance = prepare_patch(
                level.color, level.width, level.height, x, y, level.inv_color,
                level.offsets, level.radius, patch, scratch.pixels,
            )  # fmt: skip
            field[y, x, 3] = evaluate(
                level, x, y, field[y, x, 0], field[y, x, 1], field[y, x, 2],
                patch, variance, costs, top,
            )  # fmt: skip
            store_top(chosen, x, y, top)


def evaluate_field(level, field, chosen, active, threads=1):
    """Recompute the cost of what every active pixel holds (the cost function has changed)."""
    over_rows(_evaluate_rows, level, threads, field, chosen, active)


@kernel
def _collect(level, field, x, y, most, found):
    """List the neighbours whose hypotheses are worth a try: four near ones, then far ones."""
    height, width = level.height, level.width
    n = 0
    for direction in range(4):
        best = HOPELESS_COST
        for i in range(3):
            nx = x + NEAR[direction, i, 0]
            ny = y + NEAR[direction, i, 1]
            if (
                nx >= 0 and ny >= 0 and nx < width and ny < height
                and field[ny, nx, 0] > _0 and field[ny, nx, 3] < best
            ):  # fmt: skip
                best = field[ny, nx, 3]
                found[n, 0] = nx
                found[n, 1] = ny
        if best < HOPELESS_COST:
            n += 1
    for direction in range(4):
        if n >= most:
            break
        best = HOPELESS_COST
        for i in range(FAR_STEPS.shape[0]):
            nx = x + NEAR[direction, 0, 0] * FAR_STEPS[i]
            ny = y + NEAR[direction, 0, 1] * FAR_STEPS[i]
            if (
                nx >= 0 and ny >= 0 and nx < width and ny < height
                and field[ny, nx, 0] > _0 and field[ny, nx, 3] < best
            ):  # fmt: skip
                best = field[ny, nx, 3]
                found[n, 0] = nx
                found[n, 1] = ny
        if best < HOPELESS_COST:
            n += 1
    return min(n, most)


@kernel
def _change(level, w, gx, gy, pixel, i, n_refine):
    """Return the ``i``-th random change of a hypothesis, a new depth from ``n_refine`` on."""
    draw = 8 * i
    if i >= n_refine:
        return level.w_min + (level.w_max - level.w_min) * _uniform(pixel, draw), _0, _0
    kind = i % 3
    if kind != 1:
        octaves = np.float32(STEPS_PX.shape[0]) * _uniform(pixel, draw)
        octave = np.int64(octaves)
        step = STEPS_PX[octave] * (_1 + octaves - np.float32(octave))
        w += level.w_px * step * (_2 * _uniform(pixel, draw + 1) - _1)
    if kind != 0:
        bend = _uniform(pixel, draw + 2)
        bend = _2 * bend * bend * w
        gx += bend / level.fx * (_2 * _uniform(pixel, draw + 3) - _1)
        gy += bend / level.fy * (_2 * _uniform(pixel, draw + 4) - _1)
    return w, gx, gy


@kernel
def _sweep_rows(level, first, last, field, chosen, active, parity, turn, seed, scratch):
    patch = scratch.patch
    costs = scratch.costs
    top = scratch.top
    found = scratch.found
    near = SAME_PX * level.w_px
    for y in range(first, last):
        for x in range((y + parity) & 1, level.width, 2):
            if active[y, x] == 0:
                continue
            variance = prepare_patch(
                level.color, level.width, level.height, x, y, level.inv_color,
                level.offsets, level.radius, patch, scratch.pixels,
            )  # fmt: skip
            w = field[y, x, 0]
            gx = field[y, x, 1]
            gy = field[y, x, 2]
            best = field[y, x, 3]
            load_top(chosen, x, y, top)
            n = _collect(level, field, x, y, turn.n_near, found)
            pixel = np.uint64(seed) + np.uint64(y * level.width + x) * np.uint64(4096)
            n_tries = n + turn.n_refine + turn.n_random
            for i in range(n_tries):
                if i < n:
                    nx = found[i, 0]
                    ny = found[i, 1]
                    tx = field[ny, nx, 1]
                    ty = field[ny, nx, 2]
                    tw = field[ny, nx, 0] + tx * np.float32(x - nx) + ty * np.float32(y - ny)
                    bend = abs(tx - gx) + abs(ty - gy)
                    if abs(tw - w) < near and bend * level.radius < near:
                        continue
                elif i < n + turn.n_refine and best > turn.refine_below:
                    continue
                else:
                    tw, tx, ty = _change(level, w, gx, gy, pixel, i - n, turn.n_refine)
                if not _is_plausible(level, tw, tx, ty):
                    continue
                cost = improve(level, x, y, tw, tx, ty, patch, variance, costs, top, best)
                if cost < best:
                    best = cost
                    w = tw
                    gx = tx
                    gy = ty
            _store(field, y, x, w, gx, gy, best)
            store_top(chosen, x, y, top)


def sweep(level, field, chosen, active, parity, turn, seed, threads=1):
    """Update the pixels of one colour of the checkerboard.

    Each tries the hypotheses of up to ``turn.n_near`` neighbours, moved along their planes, then
    ``n_refine`` changes of its own (a step of 1/8 to 8 pixels of parallax, of the slopes, or both)
    and ``n_random`` new depths from the whole range, by which a twig that no neighbour and no
    coarse level knows is found.
    """
    over_rows(_sweep_rows, level, threads, field, chosen, active, parity, turn, seed)
