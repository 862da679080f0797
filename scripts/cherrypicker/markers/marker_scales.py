"""What one printed marker says about the scale, and how sure it is."""

from __future__ import annotations

from typing import Any

import numpy as np

from cherrypicker.markers.columns import SIDES_COLUMN
from cherrypicker.markers.combine import drop
from cherrypicker.markers.detection import Detection
from cherrypicker.markers.geometry import Observations, locate_marker
from cherrypicker.markers.layouts import Sightings

# What no scatter of the sightings shows, root mean squares over the nine rendered scenes of
# docs/scale.md: how far all of a marker's edges lie off together, px, and how far the scale where
# the marker stands is from that of the whole ring of cameras
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
    max_px : float
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
    if len({detection.photo for detection in detections}) < min_images:
        report["flags"].append(f"seen in fewer than {min_images} photos")
        return report
    observations = Observations(
        photos=np.array([detection.photo for detection in detections]),
        cam_from_world=cam_from_world[[detection.photo for detection in detections]],
        corners=np.array([detection.corners for detection in detections]),
        focal=np.array([detection.focal for detection in detections]),
        std=np.array([detection.corner_std for detection in detections]),
        side_px=np.array([detection.side_px for detection in detections]),
    )
    geometry = locate_marker(observations, max_error_px=max_px, seed=seed)
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
        "sightings": seen,
    }
    if side_m is None:
        return report | {"used": False}
    error = np.hypot(geometry.side_std / geometry.side, side_floor(report["mean_side_px"]))
    if not geometry.is_square:
        error = np.hypot(error, 0.5 * geometry.off_square)
    scale = side_m / geometry.side
    return report | {"scale": scale, "scale_std": float(scale * error)}


def side_floor(side_px: float) -> float:
    """Relative error of a marker's side that its sightings share, whatever their number."""
    return float(np.hypot(2 * EDGE_PX / side_px, DRIFT))


def marker_references(markers: list[dict], warnings: list[str]) -> list[dict]:
    """The markers of known side as references for :func:`cherrypicker.markers.combine.combine`.

    Bent ones are left out, with a warning, where others are square.
    """
    known = [marker for marker in markers if marker["side_m"] is not None]
    for marker in known:
        marker |= {
            "name": f"marker {marker['id']}",
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
    """Sightings of a marker's centre, where its diagonals cross, as a point of a layout."""
    seen = marker["sightings"]
    corners = np.concatenate([seen.corners, np.ones((*seen.corners.shape[:2], 1))], axis=2)
    diagonals = np.cross(corners[:, :2], corners[:, 2:])  # (n, 2, 3): lines
    crossing = np.cross(diagonals[:, 0], diagonals[:, 1])
    return Sightings(
        photos=seen.photos,
        cam_from_world=seen.cam_from_world,
        focal=seen.focal,
        points=np.full(len(seen), point),
        places=crossing[:, :2] / crossing[:, 2:],
    )
