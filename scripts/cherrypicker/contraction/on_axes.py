"""Contraction by limbs: every point goes to the axis of the limb whose surface it lies on."""

import numpy as np

from cherrypicker.limbs.growth import Limbs, limbs_of_wood
from cherrypicker.limbs.tubes import place_on_axis

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
    """The nearest place of its limb's axis for each point, (n_points, 3) float64."""
    moved = np.empty((len(points), 3))
    for number, limb in enumerate(found.limbs):
        rows = np.flatnonzero(found.member == number)
        if len(rows):
            segment, share = place_on_axis(points[rows], limb.tube.nodes)
            step = np.diff(limb.tube.nodes, axis=0)[segment]
            moved[rows] = limb.tube.nodes[segment] + np.clip(share, 0, 1)[:, None] * step
    return moved
