"""Wood that is known to be missing, and how much larger it makes a tree.

Photos show wood that the skeleton lacks, and the cloud may hold some that it left out. What lies
beyond the outermost wood widens the intervals of height and crown upwards; the values stay those
of the wood that was found. Where the photos end before the tree does nobody knows how far it goes
on, and a value is told to be the least.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cherrypicker.traits.crown import Crown, horizontal_width, hull_of
from cherrypicker.traits.missing_top import VOXEL, MissingTop
from cherrypicker.traits.shoot_ends import Hull


def missing_wood(
    left_out: np.ndarray,
    target: Mapping,
    photo_check: Mapping,
    top: MissingTop | None,
    foot: np.ndarray,
) -> np.ndarray:
    """Places that what is known to be missing reaches to, (n, 3) float64.

    Parameters
    ----------
    left_out : ndarray of shape (n_left_out, 3), float64
        Wood that the skeleton left out.
    target : mapping
        ``target.json``, with the loose pieces that were no part of its wood.
    photo_check : mapping
        ``photo_check.json``, with pieces of thin wood that photos show and the skeleton lacks.
    top : MissingTop, optional
        Above the foot; told to a voxel, one of which it may be taller.
    foot : ndarray of shape (3,), float64
    """
    pieces = [*target.get("loose", ()), *photo_check.get("missing_pieces", ())]
    boxes = np.array([[piece["low"], piece["high"]] for piece in pieces if "low" in piece])
    which = np.indices((2, 2, 2)).reshape(3, -1).T  # lower or upper end along each axis
    corners = boxes.reshape(-1, 2, 3)[:, which, np.arange(3)].reshape(-1, 3)
    missing = np.vstack([left_out, corners])
    if top is None:
        return missing
    return np.vstack([missing, [*foot[:2], foot[2] + top.height + VOXEL * top.found]])


def growth_by(missing: np.ndarray, crown: Crown, hull: Hull | None) -> np.ndarray:
    """By how much missing wood (n, 3) raises a crown's top, width and volume, (3,) float64."""
    grown = np.zeros(3)
    if len(missing):
        grown[0] = missing[:, 2].max() - crown.top
    if len(missing) and hull is not None:
        larger = hull_of(np.vstack([hull.points, missing]))
        grown[1] = horizontal_width(larger.points[:, :2]) - crown.width
        grown[2] = larger.volume - crown.volume
    return np.maximum(grown, 0.0)
