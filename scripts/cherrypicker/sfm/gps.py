"""The places that photos state by GPS beside those that were found: a rough check, never a source.

Who photographs a tree walks on level ground, and altitudes by GPS are poor: so the cameras are laid
into the plane that fits them best and compared with longitude and latitude there, by the similarity
that fits best, mirrored or not.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from cherrypicker.intake.places import stated_place

logger = logging.getLogger(__name__)

# A metre of latitude, degrees, on a sphere: three in a thousand off at most, far below GPS's errors
DEGREES_A_METRE = 360.0 / 40.0e6
# A similarity always fits two places; phones repeat a fix over several photos (guess)
LEAST_PLACES = 5
# What the fit may leave of the places' spread (guess: three quarters of the variance explained)
MOST_LEFT = 0.5


def stated_places(photos: Iterable[Path]) -> dict[str, tuple[float, float]]:
    """Return longitude and latitude, degrees, of the photos that state them, by file name."""
    stated = {Path(path).name: stated_place(path) for path in photos}
    return {name: (at.longitude, at.latitude) for name, at in stated.items() if at}


def compare_places(
    centers: Mapping[str, np.ndarray], places: Mapping[str, tuple[float, float]]
) -> dict | None:
    """Hold the places of cameras against those that their photos state.

    Parameters
    ----------
    centers : mapping of str to ndarray of shape (3,)
        Of the registered photos, units of the model.
    places : mapping of str to (float, float)
        Longitude and latitude, degrees.

    Returns
    -------
    dict or None
        ``n_photos``, ``n_places`` that differ, ``metres_per_unit`` and its standard error,
        ``walk_m`` (RMS distance of the stated places from their middle), ``residual_m`` (RMS of
        what the fit leaves) and ``is_consistent``; None where too few places are stated.
    """
    names = sorted(centers.keys() & places.keys())
    degrees = np.array([places[name] for name in names]).reshape(-1, 2)
    n_places = len(np.unique(degrees, axis=0))
    if n_places < LEAST_PLACES:
        return None
    middle = degrees.mean(axis=0)
    shrink = np.array([np.cos(np.radians(middle[1])), 1.0])
    stated = (degrees - middle) * shrink / DEGREES_A_METRE
    found = np.array([centers[name] for name in names])
    found = found - found.mean(axis=0)
    found = found @ np.linalg.svd(found, full_matrices=False)[2][:2].T
    fits = [_similarity(found * [1.0, side], stated) for side in (1.0, -1.0)]
    scale, residual = min(fits, key=lambda fit: fit[1])
    walk = float(np.sqrt((stated**2).sum(axis=1).mean()))
    size = float(np.sqrt((found**2).sum()))
    # Two coordinates a place, each with half of the error; repeated fixes tell nothing new
    error = residual / np.sqrt(2.0) / size * np.sqrt(len(names) / n_places)
    report = {
        "n_photos": len(names),
        "n_places": n_places,
        "metres_per_unit": scale,
        "metres_per_unit_std": error,
        "walk_m": walk,
        "residual_m": residual,
        "is_consistent": residual <= MOST_LEFT * walk,
    }
    logger.log(
        logging.INFO if report["is_consistent"] else logging.WARNING,
        "GPS of %d photos %s the cameras: %.1f m are left of a walk of %.1f m; %.3f m a unit",
        len(names),
        "fits" if report["is_consistent"] else "does not fit",
        residual,
        walk,
        scale,
    )
    return report


def _similarity(found: np.ndarray, stated: np.ndarray) -> tuple[float, float]:
    """Scale and RMS residual of the turn and scale that lay centred places (n, 2) over others."""
    a, b = found[:, 0] + 1j * found[:, 1], stated[:, 0] + 1j * stated[:, 1]
    factor = complex(np.vdot(a, b)) / max(float(np.vdot(a, a).real), 1e-12)
    return float(abs(factor)), float(np.sqrt((np.abs(b - factor * a) ** 2).mean()))
