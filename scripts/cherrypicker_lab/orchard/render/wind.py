"""Trees in the wind: how far each piece of wood is from its rest as a photo is taken.

An axis bends from its foot on: its own displacement grows with the 1.5th power of the way along
it, and comes on top of what its parent moves at the node that it starts from. So the tree stays
whole, thick old wood hardly moves and the tips of twigs move most. Each photo has a gust of its
own; all axes lean with it and swing about it with a phase of their own.
"""

import numpy as np

STIFFNESS = (0.04, 0.25, 0.7, 1.0)  # share of the amplitude by the order of the axis
WHOLE_M = 0.5  # an axis this long moves by the amplitude at its tip
POWER = 1.5


def sway(tree, amplitude, seed, photo):
    """Displacement of all nodes of a tree in one photo, an array (n, 3) float64 an axis, m.

    The amplitude is the root mean square displacement of the tip of a twig of 0.5 m against its
    foot, m; the scene's seed sets the wind's direction.
    """
    azimuth = np.random.default_rng([int(seed), 443]).uniform(0, 2 * np.pi)
    wind = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    across = np.array([-wind[1], wind[0], 0.0])
    rng = np.random.default_rng([int(seed), 449, int(photo)])
    gust = rng.normal(0.5, 0.4)
    swing = rng.normal(size=(len(tree.axes), 3)) * [0.6, 0.4, 0.25]
    moved = []
    for axis, (with_wind, beside, lift) in zip(tree.axes, swing):
        foot = moved[axis.parent][axis.parent_node] if axis.parent >= 0 else np.zeros(3)
        direction = (gust + with_wind) * wind + beside * across + [0.0, 0.0, lift]
        share = STIFFNESS[min(axis.order, len(STIFFNESS) - 1)]
        reach = amplitude * share * (axis.arclength / WHOLE_M) ** POWER
        moved.append(foot + np.minimum(reach, 2.0 * amplitude)[:, None] * direction)
    return moved


def moved_points(tree, displacement, axis, s):
    """Displacement (m, 3), in metres, of places on a tree by that of its nodes, see `sway`.

    The places lie on an axis (m,) at an arc length `s` (m,), m.
    """
    # all axes laid end to end on one line, a metre apart, are read off in one go
    lengths = [a.arclength for a in tree.axes]
    start = np.concatenate([[0.0], np.cumsum([way[-1] + 1.0 for way in lengths])[:-1]])
    line = np.concatenate([way + first for way, first in zip(lengths, start)])
    ends = np.array([way[-1] for way in lengths])
    at = start[axis] + np.minimum(s, ends[axis])
    values = np.concatenate(displacement)
    return np.stack([np.interp(at, line, values[:, c]) for c in range(3)], axis=1)
