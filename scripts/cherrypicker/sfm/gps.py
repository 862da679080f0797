"""The places that photos state by GPS beside those that were found.

Of every scan they are a rough check. Who photographs a tree walks on level ground, and altitudes by
GPS are poor: so the cameras are laid into the plane that fits them best and compared with longitude
and latitude there, by the similarity that fits best, mirrored or not.
"""

import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.geometry.similarity import fit_similarity
from cherrypicker.intake.places import Place, stated_place

logger = logging.getLogger(__name__)

# A similarity always fits two places; phones repeat a fix over several photos
LEAST_PLACES = 5
# What the fit may leave of the places' spread: of five places drawn at random 3 % fit so well, of
# four 11 %; twice as much any fit leaves, and with half a receiver off by 1 m fits no walk of 3 m
MOST_LEFT = 0.5


def stated_places(photos: Iterable[Path]) -> dict[str, Place]:
    """Return the places of the photos that state one, by file name."""
    stated = {Path(path).name: stated_place(path) for path in photos}
    return {name: place for name, place in stated.items() if place}


def compare_places(centers: Mapping[str, np.ndarray], places: Mapping[str, Place]) -> dict | None:
    """Hold the places of cameras against those that their photos state, altitudes apart.

    By the names of the registered photos, centres (3,) are in units of the model. Returns
    ``n_photos``, ``n_places`` that differ, ``metres_per_unit`` and its standard error, ``walk_m``
    (RMS distance of the stated places from their middle), ``residual_m`` (RMS of what the fit
    leaves) and ``is_consistent``; None where too few places are stated.
    """
    names = sorted(centers.keys() & places.keys())
    level = [places[name]._replace(altitude=0.0) for name in names]
    n_places = len(set(level))
    if n_places < LEAST_PLACES:
        return None
    stated = local_metres(level) * [1.0, 1.0, 0.0]
    found = np.array([centers[name] for name in names])
    found = found - found.mean(axis=0)
    # A turn in space mirrors what is flat
    flat = np.linalg.svd(found, full_matrices=False)[2][:2]
    scale, _, residual, size = fit_similarity(found @ flat.T @ np.eye(2, 3), stated)
    walk = float(np.sqrt((stated**2).sum(axis=1).mean()))
    # Two coordinates a place, each with half of the error; repeated fixes tell nothing new
    error = residual / np.sqrt(2.0) / size * np.sqrt(len(names) / n_places)
    is_consistent = residual <= MOST_LEFT * walk
    logger.log(
        logging.INFO if is_consistent else logging.WARNING,
        f"GPS of {len(names)} photos {'fits' if is_consistent else 'does not fit'} the cameras: "
        f"{residual:.1f} m are left of a walk of {walk:.1f} m; {scale:.3f} m a unit",
    )
    return {
        "n_photos": len(names),
        "n_places": n_places,
        "metres_per_unit": scale,
        "metres_per_unit_std": error,
        "walk_m": walk,
        "residual_m": residual,
        "is_consistent": is_consistent,
    }


def local_metres(places: Sequence[Place]) -> np.ndarray:
    """East, north and up, m, from the mean of n places, (n, 3); altitudes are needed."""
    positions = np.array(places)
    earth = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    return np.array(earth.ellipsoid_to_enu(positions, *positions.mean(axis=0)))
