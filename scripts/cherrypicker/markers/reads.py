"""Which reads of markers are markers: those whose rays meet in one square in space.

A detector reads markers where none are, such as a small one in each dark brick of a wall, and a
table does not name all that stand there. Where the rays of the corners meet in a square, and do so
as well as those of the markers that the table names, there is a marker. Where they meet and the
corners are too coarse to be sure, there may be one. All other reads are false.
"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from cherrypicker.markers.columns import SIDES_COLUMN
from cherrypicker.markers.combine import MOST_ERRORS
from cherrypicker.markers.detection import Detection
from cherrypicker.markers.layouts import POSES_PX
from cherrypicker.markers.marker_scales import (
    EDGE_PX,
    locate_marker,
    locate_middle,
    measure_marker,
    observe,
)
from cherrypicker.markers.reference_scales import Scan

logger = logging.getLogger(__name__)


@dataclass
class SortedReads:
    """What was read beside the markers that were asked for.

    Attributes
    ----------
    squares : list of dict
        Markers that were not asked for, as of `measure_marker`.
    again : list of dict
        Markers that were asked for, where they stand in more places than one.
    unsolved : list of dict
        ``id``, ``center`` (3,), ``radius`` and ``n_images`` of places where a marker may be.
    false : list of dict
        ``id``, ``n_images`` and ``photos`` of what is no marker.
    doubts : list of str
        A line for each marker that stands in several places.
    """

    squares: list[dict] = field(default_factory=list)
    again: list[dict] = field(default_factory=list)
    unsolved: list[dict] = field(default_factory=list)
    false: list[dict] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)

    def log(self) -> None:
        """Say what is there."""
        for square in [*self.squares, *self.again]:
            logger.info("marker %d: one more, in %d photos", square["id"], len(square["images"]))
        for place in self.unsolved:
            logger.info(
                "marker %d: may stand where %d photos show it, its square is not solved",
                place["id"],
                place["n_images"],
            )
        for one in self.false:
            logger.info("marker %d: false reads in %d photos", one["id"], one["n_images"])


@dataclass(frozen=True)
class Noise:
    """How well the corners of known markers fit squares: a mean square and its freedom."""

    misfit: float
    dof: int

    @classmethod
    def of(cls, misfits: list[tuple[float, int]]) -> Noise:
        """Of several markers."""
        dof = sum(each for _, each in misfits)
        return cls(sum(misfit * each for misfit, each in misfits) / dof, dof)

    def explains(self, misfit: float, dof: int) -> bool:
        """Whether another square's misfit may be chance (F test)."""
        chance = f_distribution.sf(misfit / self.misfit, dof, self.dof)
        return bool(chance > chi2.sf(MOST_ERRORS**2, 1))


def sort_reads(reads: list[Detection], markers: dict[int, dict], scan: Scan) -> SortedReads:
    """Tell markers from false reads.

    Parameters
    ----------
    reads : list of Detection
        Of all ids.
    markers : dict of int to dict
        What was asked for, as of `measure_marker`.

    Returns
    -------
    SortedReads
    """
    result = SortedReads()
    noise = _known_noise(reads, markers, scan)
    for marker_id in sorted({read.marker_id for read in reads}):
        rest = [read for read in reads if read.marker_id == marker_id]
        known = markers.get(marker_id, {"side_m": None})
        if "corners" in known:
            _, rest = _split(rest, known["corners"].mean(axis=0), scan)
            if not known["is_square"]:
                result.unsolved.append(_place(known))
        false: list[Detection] = []
        while rest and (place := locate_middle(observe(rest, scan.cam_from_world), **_how(scan))):
            middle, radius = place
            here, elsewhere = _split(rest, middle, scan)
            if not here:
                break
            square = _square_of(here, known["side_m"], scan)
            if square is None and _is_none(here, noise, scan):
                false += here
            elif square is None:
                found = {"center": middle, "radius": radius}
                n_images = len({read.photo for read in here})
                result.unsolved.append({"id": marker_id, **found, "n_images": n_images})
            elif noise and noise[0].explains(square["misfit"], square["misfit_dof"]):
                (result.again if "corners" in known else result.squares).append(square)
            else:
                result.unsolved.append(_place(square))
            rest = elsewhere
        if false := sorted(false + rest, key=lambda read: read.photo):
            photos = list(dict.fromkeys(Path(scan.photos[read.photo]).name for read in false))
            result.false.append({"id": marker_id, "n_images": len(photos), "photos": photos})
        again = [square for square in result.again if square["id"] == marker_id]
        if again:
            result.doubts.append(_count_places([known, *again], scan))
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


def _how(scan: Scan) -> dict:
    return {"max_error_px": scan.max_px, "seed": scan.seed}


def _known_noise(
    reads: list[Detection], markers: dict[int, dict], scan: Scan
) -> tuple[Noise, Noise] | None:
    """How the known markers fit squares, by fitted corners and by coarse ones; None without any."""
    fitted, coarse = [], []
    for marker in markers.values():
        if marker.get("is_square"):
            own = [read for read in reads if read.marker_id == marker["id"]]
            seen = observe(own, scan.cam_from_world, coarse=True)
            found = locate_marker(seen, **_how(scan))
            if found is not None:
                # Edges that lie off together show in no marker's own residuals
                unseen = (EDGE_PX / POSES_PX) ** 2
                fitted.append((marker["misfit"] + unseen, marker["misfit_dof"]))
                coarse.append((found.misfit, found.misfit_dof))
    return (Noise.of(fitted), Noise.of(coarse)) if fitted else None


def _square_of(here: list[Detection], side_m: float | None, scan: Scan) -> dict | None:
    """The square in which the reads of one place meet that match the pattern, if they do."""
    square = measure_marker(
        here[0].marker_id,
        side_m,
        [read for read in here if read.is_precise],
        scan.cam_from_world,
        min_images=max(scan.min_images, 2),
        max_px=scan.max_px,
        seed=scan.seed,
    )
    return square if "corners" in square else None


def _is_none(here: list[Detection], noise: tuple[Noise, Noise] | None, scan: Scan) -> bool:
    """Whether coarse reads of one place show that no square is there, nor any marker's pattern."""
    if noise is None or any(read.is_matched for read in here):
        return False
    found = locate_marker(observe(here, scan.cam_from_world, coarse=True), **_how(scan))
    return found is not None and not noise[1].explains(found.misfit, found.misfit_dof)


def _place(square: dict) -> dict:
    """A place of SortedReads.unsolved around corners that form no square."""
    corners, n_images = square["corners"], len(square["images"])
    center = corners.mean(axis=0)
    radius = float(np.linalg.norm(corners - center, axis=1).max())
    return {"id": square["id"], "center": center, "radius": radius, "n_images": n_images}


def _split(
    reads: list[Detection], middle: np.ndarray, scan: Scan
) -> tuple[list[Detection], list[Detection]]:
    """Reads that lie on a marker's middle (3,), nearer than their own corners, and the others."""
    seen = observe(reads, scan.cam_from_world)
    at = seen.in_cameras(middle[None])[:, 0]
    away = np.linalg.norm(at[:, :2] / at[:, 2:] - seen.middles, axis=1)
    reach = np.linalg.norm(seen.places - seen.middles[:, None], axis=-1).max(axis=1)
    is_here = (away < reach) & (at[:, 2] > 0)
    return (
        [read for read, here in zip(reads, is_here) if here],
        [read for read, here in zip(reads, is_here) if not here],
    )
