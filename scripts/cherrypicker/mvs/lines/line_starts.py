"""Where PatchMatch starts thin wood from: depths at which the lines of several photos meet.

A twig is two or three pixels wide. No coarse level shows it, and between the camera and the end of
the region lie hundreds of pixels of parallax, so that a random depth misses it a thousand times.
Yet its line stands in every photo. For a pixel on a line all depths of its ray are asked in how
many sources a line of the same sign and of like grey lies where it projects; the few depths with
the most are tried by the matching cost, whatever stands behind the twig. Propagation carries what
was found along the twig and across its width.
"""

from typing import NamedTuple

import cv2
import numpy as np

from cherrypicker.compiled import Num, inlined
from cherrypicker.mvs.kernels.hypothesis import evaluate, store, store_top
from cherrypicker.mvs.kernels.level import Level, Scratch, State, by_rows
from cherrypicker.mvs.kernels.matching import prepare
from cherrypicker.mvs.kernels.projection import BEHIND, cross_ball, depth_in, pixel_in
from cherrypicker.mvs.lines.ridges import BRIGHT, DARK, line_points, slopes_of

_0 = np.float32(0.0)
_1 = np.float32(1.0)
# Grey levels that a line may differ by between two photos: the shaded side of a branch (on the
# scene of docs/lab/dense.md 12 loses an eighth of what 24 finds, 40 gains a twentieth)
GREY_DIFFERENCE = 40
# Depths that are asked lie so many px of parallax apart; lines are three pixels wide (1.5 px and
# four tried depths find 4 % more for a quarter more of the photometric time; the cloud of the scene
# of docs/lab/dense.md then has a recall below 5 mm of radius of 0.993 instead of 0.991)
STEP_PX = np.float32(2.0)
# A line is met at so many depths beside one another, which are one: its width, and half a step
RUN_STEPS = np.float32(2.5)
# A pixel that costs less has found what it shows (guess)
UNMATCHED_COST = 0.5
# Depths of a ray that are tried by the matching cost (see STEP_PX)
N_TRIED = 2


class PhotoLines(NamedTuple):
    """Thin lines of a photo."""

    sign: np.ndarray  # (height, width) uint8: DARK or BRIGHT on the lines, else 0
    near: np.ndarray  # (height, width) uint8: signs of the lines within a pixel, bits
    grey: np.ndarray  # (height, width) uint8: the photo, smoothed by a pixel


def find_lines(photo: np.ndarray) -> PhotoLines:
    """Find what is thin, dark or bright, in a photo (height, width, 3), uint8."""
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)
    slopes = slopes_of(grey)
    found, near = np.zeros((2, *grey.shape), np.uint8)
    for sign in (DARK, BRIGHT):
        x, y = np.floor(line_points(slopes, sign)[0]).astype(int).T
        found[y, x] = sign
        own = np.where(found == sign, np.uint8(sign), np.uint8(0))
        near |= cv2.dilate(own, np.ones((3, 3), np.uint8))
    return PhotoLines(found, near, cv2.GaussianBlur(grey, (0, 0), 1.0))


@inlined
def _count_lines(
    level: Level, x: Num, y: Num, w: Num, sign: Num, grey: Num, others: PhotoLines, most: Num
) -> Num:
    """Count the sources that show a line of the same sign and of like grey where (x, y, w) lies.

    Gives up once no more than ``most`` can come together.
    """
    n = level.layout.shape[0]
    count = 0
    for s in range(n):
        if count + n - s <= most:
            break
        z = depth_in(level.project, s, x, y, w)
        if z <= BEHIND:
            continue
        u, v = pixel_in(level.project, s, x, y, w, z)
        u = np.int64(u + np.float32(0.5))
        v = np.int64(v + np.float32(0.5))
        if u < 0 or v < 0 or u >= level.layout[s, 1] or v >= level.layout[s, 2]:
            continue
        at = np.uint64(level.layout[s, 0] + v * level.layout[s, 1] + u)
        if others.near[at] & sign and abs(np.int64(others.grey[at]) - grey) < GREY_DIFFERENCE:
            count += 1
    return count


@inlined
def _collect(
    level: Level,
    x: Num,
    y: Num,
    own: PhotoLines,
    others: PhotoLines,
    ball: np.ndarray,
    depths: np.ndarray,
    counts: np.ndarray,
) -> None:
    """List the inverse depths of a pixel's ray in the ball with the most lines, the most first.

    ``counts`` is ``n_best - 1`` where there are fewer.
    """
    sign = np.int64(own.sign[y, x])
    grey = np.int64(own.grey[y, x])
    step = STEP_PX * level.w_px
    for i in range(N_TRIED):
        counts[i] = level.n_best - 1
    rx = (np.float32(x) - level.cx) / level.fx
    ry = (np.float32(y) - level.cy) / level.fy
    along, off = cross_ball(rx, ry, _1, ball)
    if off <= _0 or along <= _0:
        return
    reach = np.sqrt(off)
    w, w_high = max(level.w_min, _1 / (along + reach)), level.w_max
    if along > reach:
        w_high = min(w_high, _1 / (along - reach))
    run = -1
    while w < w_high:
        place = N_TRIED - 1
        if run >= 0 and w - depths[run] < RUN_STEPS * step:
            place = run
        most = counts[place]
        count = _count_lines(level, np.float32(x), np.float32(y), w, sign, grey, others, most)
        if count > most:
            while place > 0 and counts[place - 1] < count:
                counts[place] = counts[place - 1]
                depths[place] = depths[place - 1]
                place -= 1
            counts[place] = count
            depths[place] = w
            run = place
        w += step


@by_rows
def _start_rows(
    level: Level,
    first: Num,
    last: Num,
    state: State,
    line: np.ndarray,
    own: PhotoLines,
    others: PhotoLines,
    ball: np.ndarray,
    best: np.ndarray,
    scratch: Scratch,
) -> None:
    """Start rows; ``line`` keeps the pixels that found something better than what they had."""
    for y in range(first, last):
        depths = best[y, 0]
        counts = best[y, 1]
        for x in range(level.width):
            if line[y, x] == 0:
                continue
            _collect(level, x, y, own, others, ball, depths, counts)
            line[y, x] = 0
            if counts[0] < level.n_best:
                continue
            variance = prepare(level, x, y, scratch)
            for i in range(N_TRIED):
                if counts[i] < level.n_best:
                    break
                cost = evaluate(level, x, y, depths[i], _0, _0, variance, scratch)
                if cost < state.field[y, x, 3]:
                    store(state.field, y, x, depths[i], _0, _0, cost)
                    store_top(state.chosen, x, y, scratch.top)
                    line[y, x] = 1


def start_from_lines(
    level: Level,
    state: State,
    active: np.ndarray,
    reference: PhotoLines,
    sources: list[PhotoLines],
    ball: np.ndarray,
    threads: int = 1,
) -> np.ndarray:
    """Start the lines of a reference that match nothing yet where lines of its sources meet.

    The level is that of full size; its state changes where a line's cost becomes less. Only pixels
    that are ``active`` (height, width), uint8, are started, and only depths asked in a ``ball``:
    centre, in the reference's camera frame, and radius, (4,) float32. The sources stand in the
    level's order. Returns which pixels were started, (height, width) bool.
    """
    unmatched = (state.field[..., 3] > UNMATCHED_COST) & (active > 0)
    line = np.where(unmatched, reference.sign, 0).astype(np.uint8)
    others = PhotoLines(*(np.concatenate([*map(np.ravel, each)]) for each in zip(*sources)))
    best = np.zeros((level.height, 2, N_TRIED), dtype=np.float32)
    _start_rows(level, threads, state, line, reference, others, ball, best)
    return line > 0
