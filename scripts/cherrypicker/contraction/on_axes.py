"""Contraction by limbs: every point goes to the axis of the limb whose surface it lies on."""

import numpy as np

from cherrypicker.limbs.growth import Limbs, limbs_of_wood
from cherrypicker.limbs.joints import from_parents
from cherrypicker.limbs.tubes import seen_from

__all__ = ["move_to_axes", "points_on_axes"]


def move_to_axes(
    points: np.ndarray, base: np.ndarray, *, stem: np.ndarray | None = None
) -> tuple[np.ndarray, Limbs]:
    """Grow the limbs of a tree's wood and move its points onto their axes.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Wood of one tree, thinned evenly, z up.
    base : array-like of 3 floats
        Base of the stem.
    stem : ndarray of shape (n_points,), bool, optional
        What is known to be the stem.

    Returns
    -------
    moved : ndarray of shape (n_points, 3), float64
    limbs : Limbs

    Raises
    ------
    StageError
        If the points make no limb.
    """
    found = limbs_of_wood(points, base, stem=stem)
    return points_on_axes(points, found), found


def points_on_axes(points: np.ndarray, found: Limbs) -> np.ndarray:
    """Points on the axes of their limbs, (n_points, 3) float64.

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
        axis = whole[number]
        moved[rows] = np.stack([np.interp(way, axis.way, c) for c in axis.nodes.T], axis=1)
    return moved
