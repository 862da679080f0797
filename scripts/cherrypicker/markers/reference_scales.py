"""What a reference that is no marker of known side says about the scale, kind by kind."""

import logging
from dataclasses import fields, replace
from typing import Any

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.geometry.similarity import fit_similarity
from cherrypicker.intake.places import stated_place
from cherrypicker.markers.boards import see_charuco, see_cube
from cherrypicker.markers.layouts import MOST_OFF, Sightings, fit_layout, lay_over, locate
from cherrypicker.markers.marker_scales import DRIFT
from cherrypicker.markers.references import Reference
from cherrypicker.markers.scan import Scan
from cherrypicker.markers.tape import scale_of_trunk
from cherrypicker.sfm.gps import local_metres

logger = logging.getLogger(__name__)

_FEWEST_PHOTOS = 3  # of a board or a distance, whose error the scatter of the photos tells
# Where a tape is the only reference, the cameras are first taken to stand so far apart, m: of five
# stems all are found from where they do and from twice as far, four from half as far
_STARTS_M = (3.0, 6.0, 1.5)


class _NoScale(Exception):
    """Why a reference says nothing."""


def measure_reference(
    reference: Reference, scan: Scan, markers: dict[tuple[str, int], dict], guess: float | None
) -> dict:
    """Scale of one reference, as :func:`cherrypicker.markers.combine.combine` takes it.

    `markers` are by dictionary and id, as of `measure_marker`; `guess` is what the references
    before it say of the scale, if anything.
    """
    report: dict[str, Any] = {
        "name": reference.name,
        "kind": reference.kind,
        "key": reference.key,
        "length_m": reference.length_m if np.isfinite(reference.length_m) else None,
        "slack": 0.0,
        "used": False,
        "flags": [],
    }
    own = reference.tolerance_m / reference.length_m
    try:
        if reference.kind == "trunk":
            scale, error = _trunk(reference, scan, guess)
        elif reference.kind == "gps":
            scale, error = _gps(reference, scan)
            own = 0.0  # that of the positions is in the error
        elif reference.kind == "distance":
            scale, error = _by_layout(*_see_distance(reference, markers), scan)
        else:
            see = see_charuco if reference.kind == "charuco" else see_cube
            scale, error = _by_layout(*see(reference.values, scan), scan)
    except _NoScale as reason:
        return report | {"flags": [str(reason)]}
    except KeyError as missing:  # given by hand, past the config's schema
        raise StageError(f"{reference.kind} needs {missing}", key=reference.key) from missing
    std = float(scale * np.sqrt(error**2 + own**2 + DRIFT**2))
    logger.info("%s: %.6g +- %.2g metres per unit", reference.name, scale, std)
    return report | {"used": True, "scale": scale, "scale_std": std}


def _see_distance(reference: Reference, markers: dict) -> tuple[Sightings, np.ndarray]:
    """The centres of two markers, as `see_charuco` gives the corners of a board."""
    ends = []
    for end, marker_id in enumerate(reference.values["markers"]):
        marker = markers[reference.values["dictionary"], marker_id]
        if "sightings" not in marker:
            raise _NoScale(f"marker {marker_id}: {', '.join(marker['flags']) or 'not found'}")
        if marker["n_places"] > 1:
            raise _NoScale(f"marker {marker_id} stands in {marker['n_places']} places")
        places = np.full((len(marker["sightings"]), 2, 2), np.nan)
        places[:, end] = marker["sightings"].middles
        ends.append(replace(marker["sightings"], places=places))
    both = [np.concatenate([getattr(each, one.name) for each in ends]) for one in fields(Sightings)]
    return Sightings(*both), np.array([[0.0, 0.0, 0.0], [reference.length_m, 0.0, 0.0]])


def _by_layout(seen: Sightings, layout: np.ndarray, scan: Scan) -> tuple[float, float]:
    """By points of a layout, or of several copies of it."""
    points, agree = locate(seen, seen.tolerance_px)
    laid = lay_over(points, layout)
    n_photos = len(np.unique(seen.photos[agree.any(axis=1)]))
    fewest = max(scan.min_images, _FEWEST_PHOTOS)
    if laid is None or n_photos < fewest:
        raise _NoScale(
            f"{n_photos} of {len(scan.photos)} photos agree on where it is, {fewest} are needed"
        )
    if laid.misfit > MOST_OFF:
        raise _NoScale(
            f"its points are off the layout by {100 * laid.misfit:.1f} %: is it bent, or another?"
        )
    used = replace(seen, places=np.where(agree[..., None], seen.places, np.nan))
    size, error = fit_layout(used, laid)
    return 1 / size, error


def _trunk(reference: Reference, scan: Scan, guess: float | None) -> tuple[float, float]:
    """By a tape around the stem."""
    if scan.cloud is None:
        raise StageError("a trunk's diameter needs the denoised cloud", key=reference.key)
    spread = float(np.median(np.linalg.norm(scan.centers - scan.centers.mean(axis=0), axis=1)))
    starts = [start / spread for start in _STARTS_M]
    reasons = []
    for start in [guess, *starts] if guess else starts:  # a guess by GPS may be far off
        try:
            return scale_of_trunk(
                scan.cloud, reference.values["height_m"], reference.length_m, start, seed=scan.seed
            )
        except StageError as error:
            reasons.append(error.cause)
    raise _NoScale(reasons[0])


def _gps(reference: Reference, scan: Scan) -> tuple[float, float]:
    """By the positions that the photos' EXIF gives.

    The tolerance is the standard error of a coordinate of one; larger where they scatter more.
    """
    stated = {row: stated_place(path) for row, path in enumerate(scan.photos)}
    # One without an altitude would stand on the level of all, and make the walk too flat
    places = {row: at for row, at in stated.items() if at and np.isfinite(at.altitude)}
    n = len(places)
    if n < max(scan.min_images, 3):  # of two the turn is open
        raise _NoScale(f"{n} of {len(scan.photos)} photos have a position with altitude: too few")
    centers = scan.centers[list(places)]
    scale, _, residual, size = fit_similarity(centers, local_metres(list(places.values())))
    if scale <= 0:
        raise _NoScale("the photos' positions are one and the same")
    scatter = residual * np.sqrt(n / (3 * n - 7))
    return scale, float(max(reference.tolerance_m, scatter) / size / scale)
