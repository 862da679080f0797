"""Scale factor of a reconstruction from known lengths: markers' sides and other references.

Paper, section Scale Factor Estimator: ``s = d_aruco / d_scene``. Several lengths, of markers and of
whatever ``scale.references`` lists, are joined by `cherrypicker.markers.combine`; one that
contradicts the others is left out and reported.
"""

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.markers.combine import combine
from cherrypicker.markers.detection import Reads, detect_markers
from cherrypicker.markers.marker_scales import marker_references, measure_marker
from cherrypicker.markers.reads import sort_reads
from cherrypicker.markers.reference_scales import measure_reference
from cherrypicker.markers.references import SIDES_COLUMN, check_ids, check_scale
from cherrypicker.markers.scan import Scan

logger = logging.getLogger(__name__)


def estimate_scale(
    photos: Sequence[str | Path],
    reconstruction: Any,
    *,
    cell: str,
    mode: str,
    dictionary: str,
    sides_m: str,
    references: Sequence[Mapping | str] = (),
    **options: Any,
) -> dict:
    """Scale of a sparse model, as the content of scale.json.

    Photos of the tree that are not registered are left out. What is said of the scale is as for
    :func:`cherrypicker.markers.references.check_scale`; the options are further fields of
    :class:`cherrypicker.markers.scan.Scan`.

    Raises
    ------
    StageError
        If lengths are asked for but not described, not found, or contradict each other, or fewer
        than two of the photos are registered.
    """
    sides, known = check_scale(cell, mode, dictionary, sides_m, references)
    said = cell.strip() or mode
    scan = Scan.of(photos, reconstruction, **options)
    if sides:
        dictionary = check_ids(dictionary)
    # Markers by dictionary and id, those whose distance is known too; and what else was read
    wanted: dict[tuple[str, int], float | None] = {(dictionary, n): m for n, m in sides.items()}
    for reference in known:
        for marker_id in reference.values.get("markers", ()):
            wanted.setdefault((reference.values["dictionary"], marker_id), None)
    found = detect_markers(scan, list(dict.fromkeys(name for name, _ in wanted)))
    if sides and not known:
        _check_found(found, scan, dictionary, sides)
    markers = {
        name: measure_marker(*name, side, found.of(*name), scan) for name, side in wanted.items()
    }
    reads = sort_reads(found, markers, scan)
    # What the labels need whatever gives the scale
    beside = {
        "other_markers": reads.squares,
        "unsolved_markers": reads.unsolved,
        "false_reads": reads.false,
    }
    if said != "marker":
        if references:
            logger.warning("scale.references are not used: the scale is said to be %s", said)
        report: dict[str, Any] = {"mode": "none", "unit": "arbitrary", "scale": None}
        if said != "none":
            report = {"mode": "number", "unit": "m", "scale": float(said)}
        report |= {"scale_std": None, "n_images": 0, "n_rays": 0, "markers": [], "warnings": []}
        return report | beside
    shown, doubts = [*markers.values(), *reads.again], reads.doubts
    measured = marker_references(shown, doubts)
    for reference in sorted(known, key=lambda reference: reference.kind == "trunk"):
        scales = [one["scale"] for one in measured if one["used"]]
        guess = float(np.median(scales)) if scales else None
        measured.append(measure_reference(reference, scan, markers, guess))
    doubts += [
        f"{one['name']} gives no scale: {', '.join(one['flags'])}; {one['key']}"
        for one in measured
        if not one["used"] and "scale" not in one
    ]
    scale, scale_std = combine(measured, doubts)
    for doubt in doubts:
        logger.warning("%s", doubt)
    names = ", ".join(one["name"] for one in measured if one["used"])
    line = "scale: %.6g +- %.2g metres per unit (%.2f %%) from %s"
    logger.info(line, scale, scale_std, 100 * scale_std / scale, names)
    used = [marker for marker in shown if marker["used"]]
    for marker in shown:
        marker.pop("sightings", None)
        marker["images"] = [Path(scan.photos[index]).name for index in marker["images"]]
    told = ("name", "kind", "key", "used", "length_m", "scale", "scale_std", "check", "flags")
    return {
        "mode": "marker" if shown else "reference",
        "unit": "m",
        "scale": scale,
        "scale_std": scale_std,
        "n_images": len({name for marker in used for name in marker["images"]}),
        "n_rays": sum(marker["n_rays"] for marker in used),
        "dictionary": dictionary,
        "markers": shown,
        "references": [
            {name: ({"length_m": one.get("side_m")} | one).get(name) for name in told}
            for one in measured
        ],
        "doubts": doubts,
        "warnings": doubts,
        **beside,
    }


def _check_found(reads: Reads, scan: Scan, dictionary: str, sides: dict[int, float]) -> None:
    """Refuse when no listed marker is seen often enough, with what may help."""
    reads_of = set(zip(reads.dictionaries.tolist(), reads.ids.tolist(), reads.photos.tolist()))
    n_photos = Counter((name, marker_id) for name, marker_id, _ in reads_of)
    counts = {marker_id: n_photos.pop((dictionary, marker_id), 0) for marker_id in sides}
    if max(counts.values()) >= scan.min_images:
        return
    seen = ", ".join(f"{marker_id} in {count}" for marker_id, count in counts.items())
    others = ", ".join(
        f"{name} {marker_id} ({count})"
        for (name, marker_id), count in sorted(n_photos.items())
        if count >= scan.min_images
    )
    raise StageError(
        f"no marker is seen in {scan.min_images} photos or more (marker {seen} of "
        f"{len(scan.photos)})" + (f"; others were, in so many photos: {others}" if others else ""),
        key=f"marker_dictionary, {SIDES_COLUMN}; or scale",
    )
