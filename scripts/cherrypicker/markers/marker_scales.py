"""What one printed marker says about the scale, and how sure it is."""

from collections import Counter
from typing import Any

import numpy as np

from cherrypicker.geometry.lines import intersect_rays
from cherrypicker.markers.combine import MOST_ERRORS, drop
from cherrypicker.markers.detection import Reads
from cherrypicker.markers.layouts import MOST_OFF, Sightings, fit_layout, lay_over, meet
from cherrypicker.markers.references import KINDS, SIDES_COLUMN
from cherrypicker.markers.scan import Scan

# What no scatter of the sightings shows, root mean squares over nine rendered scenes
# (docs/lab/scale.md): how far all of a marker's edges lie off together, px, and how far the scale
# where the marker stands is from that of the whole ring of cameras
_EDGE_PX, DRIFT = 0.02, 5e-4
_UNIT_SQUARE = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])


def locate_marker(seen: Sightings, by: str = "square", seed: int = 0) -> dict[str, Any] | None:
    """Find a marker's corners and side from its sightings, whatever outliers are among them.

    The marker is in the frame of the poses, by the names of scale.json; None where no two photos
    agree on a position. The side is that of the ``square`` that explains the sightings which agree;
    or the ``mean`` distance of the points that come nearest to the rays of all, as published.
    """
    if by == "mean":
        corners = intersect_rays(seen.centers[None], seen.rays.transpose(1, 0, 2))
        used = seen
    else:
        met = meet(seen, seen.tolerance_px, seed)
        if met is None:
            return None
        corners, used = met[0], seen.select(met[1])
    laid = lay_over(corners, _UNIT_SQUARE)
    if laid is None:
        return None
    side, side_std = fit_layout(used, laid)
    rms_px = float(np.sqrt(np.mean(np.sum(used.residuals_px(corners) ** 2, axis=-1))))
    noise = MOST_ERRORS * rms_px / float(np.median(used.side_px)) / np.sqrt(len(used))
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    diagonals = np.linalg.norm(corners[:2] - corners[2:], axis=1) / np.sqrt(2)
    centered = corners - corners.mean(axis=0)
    off_plane = float(np.abs(centered @ np.linalg.svd(centered)[2][2]).max() / sides.mean())
    off_square = float(np.abs(np.concatenate([sides, diagonals]) / sides.mean() - 1).max())
    return {
        "corners": corners,  # (4, 3): free corners, each from its own rays
        "side_lengths": sides,  # (4,): between neighbouring free corners
        "square_side": float(sides.mean()) if by == "mean" else side,
        "side_std": side_std,  # relative standard error of the side
        "sightings": used,  # that agree on all four corners
        "rms_reprojection_px": rms_px,  # of the free corners
        # Largest distance of a corner from the common plane, and largest deviation of a side or of
        # a diagonal (over sqrt 2) from the mean side, both as fractions of the side
        "off_plane": off_plane,
        "off_square": off_square,
        "is_square": max(off_plane, off_square) < max(MOST_OFF, noise),
        "mean_side_px": float(used.side_px.mean()),
    }


def measure_marker(
    dictionary: str, marker_id: int, side_m: float | None, reads: Reads, scan: Scan
) -> dict:
    """Geometry and scale of one marker by its reads, as scale.json has it.

    ``used`` says whether it counts, which none of unknown side does, a `side_m` of None.
    ``sightings`` are those that agree on its four corners, to be taken out.
    """
    n_images = len(np.unique(reads.photos))
    flags: list[str] = []
    report = {
        "dictionary": dictionary,
        "id": marker_id,
        "side_m": side_m,
        "n_images": n_images,
        "n_detections": len(reads),
        "n_inliers": 0,
        "n_rays": 0,
        "n_places": 1,
        "used": False,
        "flags": flags,
        "images": [],
    }
    precise = reads.select(reads.is_precise)
    if len(np.unique(precise.photos)) >= max(scan.min_images, 2):
        reads = precise
    elif n_images:
        flags.append("coarse corners: the paper is not flat, or the pattern is blurred or covered")
    if n_images < scan.min_images:
        few = f"seen in fewer than {scan.min_images} photos" if n_images else "no photo shows it"
        flags.append(few)
        return report
    found = locate_marker(reads, scan.side, scan.seed)
    if found is None or len(np.unique(found["sightings"].photos)) < scan.min_images:
        flags.append("its sightings do not agree on a position")
        return report
    used = found["sightings"]
    if len(used) < len(reads):
        flags.append(f"{len(reads) - len(used)} of {len(reads)} sightings do not fit")
    error = np.hypot(found.pop("side_std"), np.hypot(2 * _EDGE_PX / found["mean_side_px"], DRIFT))
    if not found["is_square"]:
        flags.append(
            f"its corners do not form a flat square (off the plane {100 * found['off_plane']:.1f} "
            f"%, off the square {100 * found['off_square']:.1f} % of the side)"
        )
        error = np.hypot(error, 0.5 * found["off_square"])
    report |= found | {
        "n_inliers": len(used),
        "n_rays": 4 * len(used),
        "used": side_m is not None,
        "images": np.unique(used.photos).tolist(),
    }
    if side_m is not None:
        scale = side_m / found["square_side"]
        report |= {"scale": scale, "scale_std": float(scale * error)}
    return report


def marker_references(markers: list[dict], warnings: list[str]) -> list[dict]:
    """The markers of known side as references for :func:`cherrypicker.markers.combine.combine`.

    Bent ones are left out, with a warning, where others are square.
    """
    known = [marker for marker in markers if marker["side_m"] is not None]
    times = Counter[int]()
    for marker in known:
        times[marker["id"]] += 1
        place = f", place {times[marker['id']]}" if marker["n_places"] > 1 else ""
        marker |= {
            "name": f"marker {marker['id']}{place}",
            "kind": "marker",
            "key": SIDES_COLUMN,
            "slack": KINDS["charuco"][0],  # as well printed as a board
        }
    measured = [marker for marker in known if marker["used"]]
    bent = [marker for marker in measured if not marker["is_square"]]
    if len(bent) < len(measured):
        for marker in bent:
            drop(marker, "bent or wrongly found", warnings)
    elif bent:
        warnings.append(
            "the markers' corners do not form flat squares: is the marker bent, or the "
            "reconstruction warped?"
        )
    return known
