"""How wood bends away from a photo, told from how wide it is there.

A patch spans much of a limb, at a coarse level all of it, and the plane that suits it best lies
behind the limb's front; finer levels go on from there. Round wood of radius r (px), seen across,
falls behind its tangent plane by ``w / (2 r f)`` of inverse depth ``w`` per squared pixel, f being
the focal length.
"""

import numpy as np

from cherrypicker.compiled import Num, inlined
from cherrypicker.mvs.kernels.level import Level, Scratch, by_rows
from cherrypicker.mvs.kernels.patchmatch import NEIGHBORS

_0 = np.float32(0.0)
_2 = np.float32(2.0)
# Directions in which edges are looked for, 45 degrees apart (22.5 gave the same depths, and took
# twice the time)
ACROSS = np.array([[np.cos(a), np.sin(a)] for a in np.arange(4) * np.pi / 4], dtype=np.float32)
# Wood that is as wide, px, is flat to a patch (as far as a hypothesis is propagated)
WIDEST = int(NEIGHBORS.max())


@inlined
def _reach(
    level: Level, inverse: np.ndarray, x: Num, y: Num, own: Num, step_x: Num, step_y: Num, most: Num
) -> Num:
    """Steps from (x, y) in one direction that stay on the wood, at most ``most``, as at an edge."""
    n = 0
    while n < most:
        t = np.float32(n + 1)
        px = x + np.int64(np.rint(t * step_x))
        py = y + np.int64(np.rint(t * step_y))
        if px < 0 or py < 0 or px >= level.width or py >= level.height:
            return most
        if abs(inverse[py, px] - own) > level.w_px + t * own / level.fx:
            return n
        n += 1
    return n


@by_rows
def find_bend(
    level: Level,
    first: Num,
    last: Num,
    active: np.ndarray,
    inverse: np.ndarray,
    bend: np.ndarray,
    scratch: Scratch,
) -> None:
    """Fill zeros with the bends of active pixels, in place, as `Level.bend` holds them.

    The width is the shortest chord of pixels whose inverse depth (height, width), float32, without
    lonely outliers, 0 where unknown, is that of the middle pixel, within a pixel of parallax, and
    no steeper than 45 degrees. What is thinner than the patch bends as if it filled it; what
    reaches the photo's edge is flat.
    """
    for y in range(first, last):
        for x in range(level.width):
            own = inverse[y, x]
            if active[y, x] == 0 or own <= _0:
                continue
            chord = WIDEST
            best = -1
            for k in range(ACROSS.shape[0]):
                step_x, step_y = ACROSS[k, 0], ACROSS[k, 1]
                n = 1 + _reach(level, inverse, x, y, own, step_x, step_y, chord - 1)
                if n < chord:
                    n += _reach(level, inverse, x, y, own, -step_x, -step_y, chord - n)
                if n < chord:
                    chord = n
                    best = k
            if best < 0:
                continue
            radius = max(np.float32(chord) / _2, level.radius)
            square = own / (_2 * radius * level.fx)
            bend[y, x, 0] = np.sqrt(square) * ACROSS[best, 0]
            bend[y, x, 1] = np.sqrt(square) * ACROSS[best, 1]
            bend[y, x, 2] = square * radius * radius
