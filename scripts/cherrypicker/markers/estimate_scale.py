"""Scale factor of a reconstruction from known lengths: markers' sides and other references.

Paper, section Scale Factor Estimator: ``s = d_aruco / d_scene``. Several lengths, of markers and of
whatever ``scale.references`` lists, are joined by `cherrypicker.markers.combine`; one that
contradicts the others is left out and reported.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.markers.columns import CAMERA_DISTANCE_M, SIDES_COLUMN, choose_mode
from cherrypicker.markers.combine import combine
from cherrypicker.markers.detection import (
    Reads,
    detect_markers,
    marker_dictionary,
    suggest_dictionaries,
)
from cherrypicker.markers.marker_scales import marker_references, measure_marker
from cherrypicker.markers.reads import SortedReads, sort_reads
from cherrypicker.markers.reference_scales import measure_reference
from cherrypicker.markers.references import KEY, Reference, check_scale
from cherrypicker.markers.scan import Scan

logger = logging.getLogger(__name__)

_MAX_RELATIVE_STD = 0.05  # beyond it more photos of the references are asked for (guess)


def estimate_scale(
    photos: Sequence[str | Path],
    reconstruction: Any,
    *,
    cell: str,
    mode: str,
    dictionary: str,
    sides_m: str,
    min_images: int,
    max_reprojection_px: float,
    side: str = "square",
    references: Sequence[Mapping | str] = (),
    cloud: np.ndarray | None = None,
    threads: int = 1,
    seed: int = 0,
) -> dict:
    """Scale of a sparse model, as the content of scale.json.

    Parameters
    ----------
    photos : list of path-like
        The tree's photos; those that are not registered are left out.
    cell, mode : str
        As for :func:`cherrypicker.markers.columns.choose_mode`.
    dictionary, sides_m : str
        The columns ``marker_dictionary`` and ``marker_sides_m``.
    min_images : int
        Photos that must agree on a marker or on a board.
    max_reprojection_px : float
        Beyond it a sighting is an outlier.
    side : {"square", "mean"}
        As `by` of :func:`cherrypicker.markers.marker_scales.locate_marker`.
    references : sequence of mapping or str
        The config's ``scale.references``.
    cloud : ndarray of shape (n, 3), optional
        The denoised cloud, aligned frame, for a reference of kind ``trunk``.

    Raises
    ------
    StageError
        If lengths are asked for but not described, not found, or contradict each other.
    """
    sides, known = check_scale(cell, mode, dictionary, sides_m, references)
    mode, value = choose_mode(cell, mode)
    if mode != "marker":
        logger.info("scale: %s%s", mode, "" if value is None else f", {value:g} metres per unit")
        if references:
            logger.warning(
                "scale.references are not used: the scale is said to be %s", cell or mode
            )
        unit = "m" if mode == "number" else "arbitrary"
        counts = {"scale_std": None, "n_images": 0, "n_rays": 0}
        lists = ("markers", "other_markers", "unsolved_markers", "false_reads", "warnings")
        return {
            "mode": mode,
            "unit": unit,
            "scale": value,
            **counts,
            **{name: [] for name in lists},
        }
    scan = Scan.of(
        photos,
        reconstruction,
        cloud=cloud,
        min_images=min_images,
        max_px=max_reprojection_px,
        side=side,
        threads=threads,
        seed=seed,
    )
    markers, reads = _find_markers(scan, dictionary, sides, known)
    shown = [*markers[dictionary].values(), *reads.again]
    measured = marker_references(shown, reads.doubts)
    for reference in sorted(known, key=lambda reference: reference.kind == "trunk"):
        own = markers.get(reference.values.get("dictionary", ""), {})
        scales = [one["scale"] for one in measured if one["used"]]
        guess = float(np.median(scales)) if scales else None
        measured.append(measure_reference(reference, scan, own, guess))
    return _report(scan, measured, shown, reads, dictionary)


def _find_markers(
    scan: Scan, dictionary: str, sides: dict[int, float], known: list[Reference]
) -> tuple[dict[str, dict[int, dict]], SortedReads]:
    """Markers by dictionary and id, those whose distance is known too; and what else was read."""
    wanted: dict[str, dict[int, float | None]] = {dictionary: dict(sides)}
    for reference in known:
        for marker_id in reference.values.get("markers", ()):
            wanted.setdefault(reference.values["dictionary"], {}).setdefault(marker_id, None)
    markers: dict[str, dict[int, dict]] = {}
    reads = SortedReads()
    for name, ids in wanted.items():
        if not ids:
            markers[name] = {}
            continue
        read = detect_markers(scan, marker_dictionary(name))
        if name == dictionary and not known:
            _check_found(read, scan, name, sides)
        markers[name] = {
            marker_id: measure_marker(marker_id, side, read.select(read.ids == marker_id), scan)
            for marker_id, side in ids.items()
        }
        found = sort_reads(read, markers[name], scan)
        if name == dictionary:
            found.doubts[:0] = reads.doubts
            reads = found
        else:
            reads.doubts += found.doubts
    return markers, reads


def _report(
    scan: Scan,
    measured: list[dict],
    markers: list[dict],
    reads: SortedReads,
    dictionary: str,
) -> dict:
    """Join the references and write down what they are."""
    doubts = reads.doubts
    for one in measured:
        if not one["used"] and "scale" not in one:
            doubts.append(f"{one['name']} gives no scale: {', '.join(one['flags'])}; {one['key']}")
    scale, scale_std = combine(measured, doubts)
    warnings = list(doubts)
    _check_plausible(scale, scale_std, scan.centers, markers, warnings)
    for marker in markers:
        marker.pop("sightings", None)
        marker["images"] = [Path(scan.photos[index]).name for index in marker["images"]]
    for warning in warnings:
        logger.warning("%s", warning)
    used = [one for one in measured if one["used"]]
    logger.info(
        "scale: %.6g +- %.2g metres per unit (%.2f %%) from %s",
        scale,
        scale_std,
        100 * scale_std / scale,
        ", ".join(one["name"] for one in used),
    )
    shown = [marker for marker in markers if marker["used"]]
    names = ("name", "kind", "key", "used", "length_m", "scale", "scale_std", "check", "flags")
    return {
        "mode": "marker" if markers else "reference",
        "unit": "m",
        "scale": scale,
        "scale_std": scale_std,
        "n_images": len({name for marker in shown for name in marker["images"]}),
        "n_rays": sum(marker["n_rays"] for marker in shown),
        "dictionary": dictionary,
        "markers": markers,
        "references": [
            {name: ({"length_m": one.get("side_m")} | one).get(name) for name in names}
            for one in measured
        ],
        "other_markers": [
            {
                "id": marker["id"],
                "corners": marker["corners"],
                "n_images": len(marker["images"]),
                "rms_px": marker["rms_reprojection_px"],
            }
            for marker in reads.squares
        ],
        "unsolved_markers": reads.unsolved,
        "false_reads": reads.false,
        "doubts": doubts,
        "warnings": warnings,
    }


def _check_found(read: Reads, scan: Scan, dictionary: str, sides: dict[int, float]) -> None:
    """Refuse when no listed marker is seen often enough, with what may help."""
    n_photos = len(scan.photos)
    seen_in = Counter(marker_id for marker_id, _ in set(zip(read.ids.tolist(), read.photos)))
    counts = {marker_id: seen_in.pop(marker_id, 0) for marker_id in sides}
    for marker_id, count in counts.items():
        logger.info("marker %d: seen in %d of %d photos", marker_id, count, n_photos)
    if max(counts.values()) >= scan.min_images:
        return
    seen = ", ".join(f"{marker_id} in {count}" for marker_id, count in counts.items())
    hint = ""
    if seen_in:
        listed = ", ".join(f"{marker_id} ({count})" for marker_id, count in sorted(seen_in.items()))
        hint = f"; other ids of {dictionary} were seen, in so many photos: {listed}"
    elif max(counts.values()) == 0 and (suggestion := suggest_dictionaries(scan.photos)):
        hint = f"; {suggestion}"
    raise StageError(
        f"no marker is seen in {scan.min_images} photos or more "
        f"(marker {seen} of {n_photos}){hint}",
        key=f"marker_dictionary, {SIDES_COLUMN}; or scale",
    )


def _check_plausible(
    scale: float,
    scale_std: float,
    centers: np.ndarray,
    markers: list[dict],
    warnings: list[str],
) -> None:
    """Refuse scales under which the photographer stood impossibly near or far."""
    used = [marker["corners"] for marker in markers if marker["used"]]
    corners = np.concatenate(used) if used else centers
    distance = float(scale * np.median(np.linalg.norm(centers - corners.mean(axis=0), axis=1)))
    low, high = CAMERA_DISTANCE_M
    if not low <= distance <= high:
        what = "marker: are the sides" if used else "middle: are the lengths"
        raise StageError(
            f"the cameras would stand {distance:.3g} m from the {what} in metres?",
            key=SIDES_COLUMN if used else KEY,
        )
    logger.info("the cameras' median distance to the references is %.2f m", distance)
    if scale_std > _MAX_RELATIVE_STD * scale:
        warnings.append(
            f"the scale is known only to {100 * scale_std / scale:.0f} %: show the markers in more "
            "photos from more directions"
        )
    for marker in markers:
        for flag in marker["flags"]:
            logger.info("marker %d: %s", marker["id"], flag)
