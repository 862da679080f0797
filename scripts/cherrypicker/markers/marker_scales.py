"""What one printed marker says about the scale, and how sure it is."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from cherrypicker.markers.columns import SIDES_COLUMN
from cherrypicker.markers.combine import drop
from cherrypicker.markers.detection import Detection
from cherrypicker.markers.geometry import Observations, locate_marker
from cherrypicker.markers.layouts import Sightings

# What no scatter of the sightings shows, root mean squares over nine rendered scenes
# (docs/lab/scale.md): how far all of a marker's edges lie off together, px, and how far the scale
# where the marker stands is from that of the whole ring of cameras
EDGE_PX, DRIFT = 0.02, 5e-4
# Printers and rulers: two correct markers may differ by 0.5 %, three of these each (guess)
PRINT_STD = 0.0017


def measure_marker(
    marker_id: int,
    side_m: float | None,
    detections: list[Detection],
    cam_from_world: np.ndarray,
    *,
    min_images: int,
    max_px: float,
    by: str = "square",
    seed: int,
) -> dict:
    """Geometry and scale of one marker.

    Parameters
    ----------
    side_m : float or None
        None for a marker of unknown side, which gives no scale by itself.
    detections : list of Detection
        Of this marker.
    cam_from_world : ndarray of shape (n_photos, 3, 4)
    min_images : int
        Photos that must agree.
    max_px, by : float, {"square", "mean"}
        As of :func:`cherrypicker.markers.geometry.locate_marker`.

    Returns
    -------
    dict
        The marker in scale.json; `used` says whether it counts. ``sightings`` are those that agree
        on its four corners, to be taken out.
    """
    report: dict[str, Any] = {
        "id": marker_id,
        "side_m": side_m,
        "n_images": len({detection.photo for detection in detections}),
        "n_detections": len(detections),
        "n_inliers": 0,
        "n_rays": 0,
        "n_places": 1,
        "used": False,
        "flags": [],
        "images": [],
    }
    precise = [detection for detection in detections if detection.is_precise]
    if len({detection.photo for detection in precise}) >= max(min_images, 2):
        detections = precise
    elif detections:
        report["flags"].append(
            "coarse corners: the paper is not flat, or the pattern is blurred or covered"
        )
    if report["n_images"] < min_images:
        report["flags"].append(
            f"seen in fewer than {min_images} photos" if detections else "no photo shows it"
        )
        return report
    observations = observe(detections, cam_from_world)
    geometry = locate_marker(observations, max_error_px=max_px, by=by, seed=seed)
    if geometry is None or len(np.unique(observations.photos[geometry.inliers])) < min_images:
        report["flags"].append("its sightings do not agree on a position")
        return report
    outliers = len(observations) - int(geometry.inliers.sum())
    if outliers:
        report["flags"].append(f"{outliers} of {len(observations)} sightings do not fit")
    if not geometry.is_square:
        report["flags"].append(
            f"its corners do not form a flat square (off the plane {100 * geometry.off_plane:.1f} "
            f"%, off the square {100 * geometry.off_square:.1f} % of the side)"
        )
    seen = observations.select(geometry.inliers)
    report |= {
        "n_inliers": len(seen),
        "n_rays": 4 * len(seen),
        "used": True,
        "is_square": bool(geometry.is_square),
        "images": sorted({int(index) for index in seen.photos}),
        "corners": geometry.corners,
        "side_lengths": geometry.side_lengths,
        "mean_side": float(geometry.side_lengths.mean()),
        "square_side": geometry.side,
        "rms_reprojection_px": geometry.rms_px,
        "mean_side_px": float(seen.side_px.mean()),
        "off_plane": geometry.off_plane,
        "off_square": geometry.off_square,
        "misfit": geometry.misfit,
        "misfit_dof": geometry.misfit_dof,
        "sightings": seen,
    }
    if side_m is None:
        return report | {"used": False}
    error = np.hypot(geometry.side_std / geometry.side, side_floor(report["mean_side_px"]))
    if not geometry.is_square:
        error = np.hypot(error, 0.5 * geometry.off_square)
    scale = side_m / geometry.side
    return report | {"scale": scale, "scale_std": float(scale * error)}


def observe(
    detections: list[Detection], cam_from_world: np.ndarray, *, coarse: bool = False
) -> Observations:
    """Detections of one marker with the poses (n_photos, 3, 4) of their photos.

    With `coarse` by the corners as they were before the pattern was fitted.
    """
    photos = np.array([detection.photo for detection in detections])
    return Observations(
        photos=photos,
        cam_from_world=cam_from_world[photos],
        corners=np.array([each.coarse if coarse else each.corners for each in detections]),
        focal=np.array([detection.focal for detection in detections]),
        std=np.array([each.coarse_std if coarse else each.corner_std for each in detections]),
        side_px=np.array([detection.side_px for detection in detections]),
    )


def side_floor(side_px: float) -> float:
    """Relative error of a marker's side that its sightings share, whatever their number."""
    return float(np.hypot(2 * EDGE_PX / side_px, DRIFT))


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
            "slack": PRINT_STD,
        }
    measured = [marker for marker in known if marker["used"]]
    if any(marker["is_square"] for marker in measured):
        for marker in measured:
            if not marker["is_square"]:
                drop(marker, "bent or wrongly found", warnings)
    elif measured:
        warnings.append(
            "the markers' corners do not form flat squares: is the marker bent, or the "
            "reconstruction warped?"
        )
    return known


def marker_centers(marker: dict, point: int) -> Sightings:
    """Sightings of a marker's centre as a point of a layout."""
    seen = marker["sightings"]
    return Sightings(
        photos=seen.photos,
        cam_from_world=seen.cam_from_world,
        focal=seen.focal,
        points=np.full(len(seen), point),
        places=seen.middles,
    )
