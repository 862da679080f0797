"""Where the cameras stood by the GPS of their photos, and the scale that follows: a rough check."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pycolmap

from cherrypicker.geometry.similarity import best_turn
from cherrypicker.intake.places import Place

_FEWEST = 3  # positions: fewer leave the turn open


def local_metres(places: Sequence[Place]) -> np.ndarray:
    """East, north and up, m, from the mean of n places, (n, 3); altitudes are needed."""
    positions = np.array(places)
    earth = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    return np.array(earth.ellipsoid_to_enu(positions, *positions.mean(axis=0)))


def scale_of_positions(
    centers: np.ndarray, metres: np.ndarray, tolerance_m: float
) -> tuple[float, float] | None:
    """Scale that brings cameras onto their measured positions, and its relative standard error.

    Parameters
    ----------
    centers, metres : ndarray of shape (n, 3)
        Cameras in the model, and as measured.
    tolerance_m : float
        Standard error of a coordinate of a measured position; larger where they scatter more.

    Returns
    -------
    (float, float) or None
        None for fewer than three positions, or positions in one place.
    """
    if len(centers) < _FEWEST:
        return None
    source, target = centers - centers.mean(axis=0), metres - metres.mean(axis=0)
    rotation, gain = best_turn(target.T @ source)
    spread = float(np.square(source).sum())
    scale = gain / spread if spread > 0 else 0.0
    if scale <= 0:
        return None
    residual = target - scale * source @ rotation.T
    scatter = np.sqrt(np.square(residual).sum() / max(3 * len(centers) - 7, 1))
    return scale, float(max(tolerance_m, scatter) / np.sqrt(spread) / scale)
