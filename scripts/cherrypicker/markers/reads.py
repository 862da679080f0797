"""Which reads of markers are markers: those whose rays meet in one square in space.

A detector reads markers where none are, such as a small one in each dark brick of a wall, and a
table does not name all that stand there. Where photos show the whole pattern and the rays of its
corners meet in a square, there is a marker. Where they meet and the corners are too coarse to be
sure, there may be one. All other reads are false.
"""

import logging
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from cherrypicker.geometry.directions import unit
from cherrypicker.markers.detection import Reads
from cherrypicker.markers.layouts import Sightings, meet
from cherrypicker.markers.marker_scales import locate_marker, measure_marker
from cherrypicker.markers.references import SIDES_COLUMN
from cherrypicker.markers.scan import Scan

logger = logging.getLogger(__name__)


@dataclass
class SortedReads:
    """What was read beside the markers that were asked for."""

    # ``dictionary``, ``id``, ``corners`` (4, 3), ``n_images`` and ``rms_px`` of markers
    squares: list[dict] = field(default_factory=list)
    # As of `measure_marker`: what was asked for, where it stands in more places than one
    again: list[dict] = field(default_factory=list)
    # ``dictionary``, ``id``, ``center`` (3,), ``radius`` and ``n_images`` of places where a marker
    # may be
    unsolved: list[dict] = field(default_factory=list)
    # ``dictionary``, ``id``, ``n_images`` and ``photos`` of what is no marker
    false: list[dict] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)  # of each marker that stands in several places


def sort_reads(reads: Reads, markers: dict[tuple[str, int], dict], scan: Scan) -> SortedReads:
    """Tell markers from false reads, of all dictionaries and ids.

    `markers` are what was asked for, by dictionary and id, as of `measure_marker`.
    """
    result = SortedReads()
    for name in sorted(set(zip(reads.dictionaries.tolist(), reads.ids.tolist()))):
        who = dict(zip(("dictionary", "id"), name))
        rest = reads.of(*name)
        asked = markers.get(name, {})
        places = [asked] if "corners" in asked else []
        if places:
            rest = rest.select(~_lie_on(rest, asked["corners"].mean(axis=0)))
            if not asked["is_square"]:
                result.unsolved.append(who | _around(asked))
        false: list[int] = []
        while found := locate_middle(rest, scan):
            middle, radius = found
            is_here = _lie_on(rest, middle)
            if not is_here.any():
                break
            here, rest = rest.select(is_here), rest.select(~is_here)
            marker = measure_marker(*name, asked.get("side_m"), here.select(here.is_precise), scan)
            if "corners" not in marker:
                # Coarse corners without the pattern may still show that no square is there
                met = None
                if not here.is_matched.any():
                    met = locate_marker(here, seed=scan.seed)
                if met and not met["is_square"]:
                    false += here.photos.tolist()
                else:
                    n_images = len(np.unique(here.photos))
                    spot = {"center": middle, "radius": radius, "n_images": n_images}
                    result.unsolved.append(who | spot)
            elif not marker["is_square"]:
                result.unsolved.append(who | _around(marker))
            elif places:
                places.append(marker)
            else:
                square = {"corners": marker["corners"], "n_images": len(marker["images"])}
                result.squares.append(who | square | {"rms_px": marker["rms_reprojection_px"]})
        false += rest.photos.tolist()
        if false:
            photos = [Path(scan.photos[photo]).name for photo in sorted(set(false))]
            result.false.append(who | {"n_images": len(photos), "photos": photos})
        if len(places) > 1:
            result.again += places[1:]
            result.doubts.append(_count_places(places, scan))
    counts = {name: len(found) for name, found in vars(result).items()}
    logger.info("of reads that were not asked for: %s", counts)
    return result


def _count_places(places: list[dict], scan: Scan) -> str:
    """Note in a marker's places how many there are; a line on why that may be."""
    for place in places:
        place["n_places"] = len(places)
        place["flags"].append(f"stands in {len(places)} places")
    n_shown = Counter(photo for place in places for photo in place["images"])
    both = [photo for photo, n in sorted(n_shown.items()) if n > 1]
    why = "no photo shows two of them: it was moved, or there are several of one id"
    if both:
        why = f"{Path(scan.photos[both[0]]).name} shows two of them: there are several of one id"
    n_images = " and ".join(str(len(place["images"])) for place in places)
    return (
        f"marker {places[0]['id']} stands in {len(places)} places, in {n_images} photos; {why}; "
        f"check {SIDES_COLUMN}"
    )


def _around(marker: dict) -> dict:
    """A place of SortedReads.unsolved around corners that form no square."""
    corners, n_images = marker["corners"], len(marker["images"])
    center = corners.mean(axis=0)
    radius = float(np.linalg.norm(corners - center, axis=1).max())
    return {"center": center, "radius": radius, "n_images": n_images}


def _lie_on(reads: Reads, middle: np.ndarray) -> np.ndarray:
    """Whether reads lie on a marker's middle (3,), nearer than their own corners, (n,) bool."""
    at = reads.in_cameras(middle[None])[:, 0]
    away = np.linalg.norm(at[:, :2] / at[:, 2:] - reads.middles, axis=1)
    reach = np.linalg.norm(reads.places - reads.middles[:, None], axis=-1).max(axis=1)
    return (away < reach) & (at[:, 2] > 0)


def locate_middle(seen: Sightings, scan: Scan) -> tuple[np.ndarray, float] | None:
    """Find where most rays through the middles meet, for corners that no square explains.

    The middle, (3,), and the radius of the print around it with the error of the middle; None where
    no two photos agree on a position.
    """
    middles = replace(seen, places=seen.middles[:, None])
    met = meet(middles, seen.tolerance_px, scan.seed)
    if met is None:
        return None
    points, used, middle = met[0], seen.select(met[1]), met[0][0]
    depth = used.in_cameras(points)[:, 0, 2]
    reach = np.linalg.norm(used.places - used.middles[:, None], axis=-1).max(axis=1) * depth
    rays = unit(used.centers - middle)
    weights = (used.focal / (depth * used.noise_px)) ** 2
    normal = np.einsum("n,nij->ij", weights, np.eye(3) - rays[:, :, None] * rays[:, None, :])
    error = np.sqrt(1 / np.linalg.eigvalsh(normal)[0])
    return middle, float(reach.max() + error)
