"""Filling of the gap that a calibration ring leaves in the stem."""

import logging

import numpy as np

from cherrypicker.geometry.circles import fit_circle
from cherrypicker.wood.gaps import STEM_GAP_M

__all__ = ["fill_stem_gaps"]

logger = logging.getLogger(__name__)

RIM_SHARE = 0.5  # of the gap's height: how far the rims reach below and above it
FEWEST_RIM_POINTS = 8
GAP_IN_SPACINGS = 4.0
NEAR_STEM = 3.0  # stem radii around the axis that belong to the stem


def fill_stem_gaps(points, labels, base, *, spacing, stem_gap_m=STEM_GAP_M):
    """Points on the stem's surface where a ring, a tape or a hand hides all of it.

    Heights without any trunk point, between trunk points below and above, are filled with rings
    of points on the cone between the circles that fit the two rims. The points exist for the
    contraction only, so that the trunk contracts as one.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Thinned wood of one tree, z up.
    labels : ndarray of shape (n_points,), int
    base : ndarray of shape (3,)
        Base of the stem.
    spacing : float
        Distance between points.
    stem_gap_m : float, default 0.6
        Longest gap that is filled.

    Returns
    -------
    ndarray of shape (n_filled, 3), float64
        Empty where the stem has no gap.
    """
    trunk = points[labels == 1]
    if len(trunk) < 2 * FEWEST_RIM_POINTS:
        return np.empty((0, 3))
    z = np.sort(trunk[:, 2])
    steps = np.diff(z)
    limit = GAP_IN_SPACINGS * spacing
    filled = [np.empty((0, 3))]
    for index in np.flatnonzero((steps > limit) & (steps <= stem_gap_m)):
        low, high = z[index], z[index + 1]
        ring = _fill_one(trunk, low, high, spacing)
        if ring is not None:
            logger.info("filled a gap of %.0f mm in the stem at z = %.3f", 1e3 * (high - low), low)
            filled.append(ring)
    return np.vstack(filled)


def _fill_one(trunk, low, high, spacing):
    """Rings of points between two rims, or None where a rim is no stem."""
    reach = max(RIM_SHARE * (high - low), 6 * spacing)
    rims = []
    for inside in (
        (trunk[:, 2] >= low - reach) & (trunk[:, 2] <= low),
        (trunk[:, 2] >= high) & (trunk[:, 2] <= high + reach),
    ):
        if np.count_nonzero(inside) < FEWEST_RIM_POINTS:
            return None
        rim = trunk[inside]
        centre, radius = fit_circle(rim[:, :2])
        spread = float(
            np.median(np.linalg.norm(rim[:, :2] - np.median(rim[:, :2], axis=0), axis=1))
        )
        if not np.isfinite(radius) or radius > 2.5 * max(spread, spacing):
            centre, radius = np.median(rim[:, :2], axis=0), max(spread, spacing)
        rims.append((centre, radius, float(np.median(rim[:, 2]))))
    (below, radius_below, z_below), (above, radius_above, z_above) = rims
    if np.linalg.norm(above - below) > 0.5 * (z_above - z_below) + NEAR_STEM * radius_below:
        return None
    rings = []
    for level, z in enumerate(np.arange(low + spacing, high, spacing)):
        share = np.clip((z - z_below) / (z_above - z_below), 0, 1)
        radius = (1 - share) * radius_below + share * radius_above
        n_around = max(6, int(round(2 * np.pi * radius / spacing)))
        angle = 2 * np.pi * (np.arange(n_around) + 0.5 * (level % 2)) / n_around
        x, y = (1 - share) * below + share * above
        around = (x + radius * np.cos(angle), y + radius * np.sin(angle), np.full(n_around, z))
        rings.append(np.stack(around, axis=1))
    return np.vstack(rings) if rings else None
