"""Whether points tell a short limb from noise of its parent and from a clump of stray points.

Two models of the same points are compared by the Bayesian information criterion (Schwarz,
"Estimating the dimension of a model", Annals of Statistics 1978). Points of a cloud from photos err
together with those around them, and so do all where a tube does not follow the wood, so that many
say no more than few: as many as the residuals on thick limbs show count as one (a design effect, as
of a sample that is drawn in clusters).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import i0e

from cherrypicker.geometry.robust import TUKEY
from cherrypicker.limbs.tubes import Tube, seen_from

__all__ = ["points_that_err_together", "tell_limb"]

N_TUBE = 6  # numbers that a limb adds to its parent: its place there, heading, length and radius
N_CLUMP = 4  # those of a clump of points: its middle and its spread
# Neighbours over which errors are added up: on foreign_a's limbs they correlate by 0.65, 0.23, 0.13
# and 0.07 with those of the 1st, 11th, 20th and 39th
N_TOGETHER = 40


def points_that_err_together(points: np.ndarray, residual: np.ndarray) -> float:
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


def tell_limb(
    points: np.ndarray, tube: Tube, parent: Tube, *, start: float, noise: float, together: float
) -> bool:
    """Whether points tell a tube from noise of its parent's surface and from a clump.

    Of the parent's points some are stray, beyond Tukey's cutoff. A clump is a Gaussian ball. A tube
    has the density of Rice across and the same all along from where its parent claims no points to
    its tip, so that what hangs on nothing is sooner a clump.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    tube, parent : Tube
    start : float
        Way along the tube from which its points are not taken for its parent's.
    noise : float
        Standard deviation of a point in each direction.
    together : float
        See `points_that_err_together`.
    """
    n_told = len(points) / together
    price = np.log(max(n_told, np.e)) * together
    on_parent, on_tube = seen_from(parent, points), seen_from(tube, points)
    off_parent, off = (
        np.hypot(one.away - one.radius, one.beyond) / noise for one in (on_parent, on_tube)
    )
    gain = np.square(np.minimum(off_parent, TUKEY)) - np.square(np.minimum(off, TUKEY))
    if gain.sum() <= N_TUBE * price:
        return False
    reach = on_tube.way.max() - min(start, on_tube.way.min())
    spread = points.var(axis=0).mean()
    if not (reach > 0 and spread > 0):
        return False
    scatter = max(1.0, np.square(off).mean())  # its own, as a clump has, in noises^2
    variance = scatter * noise**2
    of_tube = (
        np.log(i0e(on_tube.away * on_tube.radius / variance))
        - np.square(off) / (2 * scatter)
        - np.log(2 * np.pi * variance * reach)
    ).sum()
    of_clump = -1.5 * len(points) * (1 + np.log(2 * np.pi * spread))
    return bool(2 * (of_tube - of_clump) > (N_TUBE + 1 - N_CLUMP) * price)
