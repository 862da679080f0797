"""Contraction by limbs: every point goes to the axis of the limb whose surface it lies on."""

import numpy as np

from cherrypicker.limbs.growth import Limbs
from cherrypicker.limbs.joints import from_parents
from cherrypicker.limbs.tubes import seen_from

__all__ = ["points_on_axes"]


def points_on_axes(points: np.ndarray, found: Limbs) -> np.ndarray:
    """Points on the axes of their limbs, (n_points, 3) float64: those that `found` was grown from.

    Each goes to the nearest place of its limb's axis. Where a limb runs inside its parent it has no
    surface: the points of a piece as long as that, where it comes out, spread over both.
    """
    moved = np.empty((len(points), 3))
    whole = from_parents(found.limbs, found.spacing)
    for number, limb in enumerate(found.limbs):
        rows = np.flatnonzero(found.member == number)
        if not len(rows):
            continue
        seen = seen_from(limb.tube, points[rows])
        hidden = whole[number].length - limb.tube.length
        piece = min(hidden, limb.tube.length)
        way = np.interp(
            seen.way, [0.0, piece, limb.tube.length], [0.0, piece + hidden, whole[number].length]
        )
        moved[rows] = whole[number].at(way).nodes
    return moved
