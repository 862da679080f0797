"""Whether points tell a limb from noise of its parent and from a bump of its surface.

Two models of the same points are compared by the Bayesian information criterion (Schwarz,
"Estimating the dimension of a model", Annals of Statistics 1978). Points of a cloud from photos err
together with those around them, and so do all where a tube does not follow the wood, so that many
say no more than few: their number is divided by the design effect that the residuals on the limbs
show, as that of a sample that is drawn in clusters.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.limbs.tubes import Tube, seen_from

__all__ = ["N_TOGETHER", "design_effect", "is_supported"]

N_TUBE = 6  # numbers that a limb adds to its parent: its place there, heading, length and radius
N_BUMP = 4  # those of a bump: its place there, extent and height
# Neighbours over which errors are added up: on foreign_a's limbs they correlate by 0.65, 0.23, 0.13
# and 0.07 with those of the 1st, 11th, 20th and 39th
N_TOGETHER = 40


def design_effect(points: np.ndarray, residual: np.ndarray) -> float:
    """How many points tell as much as one whose error is its own.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        On one limb.
    residual : ndarray of shape (n_points,), float64
        Their distances from its surface, without outliers.

    Returns
    -------
    float
        1 where the errors are independent or there are too few points to tell.
    """
    if len(points) <= N_TOGETHER:
        return 1.0
    off = residual - residual.mean()
    around = cKDTree(points).query(points, k=N_TOGETHER)[1]
    together = float((off * off[around].sum(axis=1)).sum() / np.square(off).sum())
    return max(together, 1.0)


def is_supported(
    points: np.ndarray,
    tube: Tube,
    parent: Tube,
    *,
    weight: np.ndarray,
    noise: float,
    effect: float,
) -> bool:
    """Whether points tell a tube from noise of its parent's surface and from a bump of it.

    The points of a bump (a knob, a patch of bark, a section that is no circle) lie a height off the
    parent's surface, with a scatter of their own, and no higher than the parent is thick; those of
    a limb lead away from it, and lie on the tube with one of theirs. Neither scatters less than the
    noise.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    tube, parent : Tube
    weight : ndarray of shape (n_points,), float64
        How much of a point of the parent each tells.
    noise : float
        Standard deviation of a point in each direction.
    effect : float
        See `design_effect`.
    """
    told = weight.sum()
    if not told:  # no point is nearest to it
        return False
    price = np.log(max(told / effect, np.e)) * effect
    on_parent, on_tube = seen_from(parent, points), seen_from(tube, points)
    off_parent, off = (
        np.hypot(one.away - one.radius, one.beyond) / noise for one in (on_parent, on_tube)
    )
    thick = 2 * np.average(on_parent.radius, weights=weight) / noise
    from_bump = np.square(off_parent - min(np.average(off_parent, weights=weight), thick))
    bump, limb = (
        max(1.0, np.average(square, weights=weight)) for square in (from_bump, np.square(off))
    )
    return bool(told * np.log(bump / limb) > (N_TUBE - N_BUMP) * price)
