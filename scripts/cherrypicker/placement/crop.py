"""Region of interest: of the cloud, what stands on the ground that the cameras look at.

The paper (section Region of Interest) takes the axis-aligned x/y box of the camera origins, on the
assumption that the cameras stand around the tree: the option region "cameras". The default keeps
the vertical shadow of the region of :mod:`cherrypicker.placement.region`, which is as wide and
needs no such assumption. Which tree in it is the target is decided once, after the labels
(:mod:`cherrypicker.wood.target`).
"""

import logging

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.placement.footprint import Footprint
from cherrypicker.placement.ground import LOWEST_PERCENTILE, MOST_POINTS, AlignOptions, ground_cells
from cherrypicker.placement.region import look_at_point
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)


def crop_roi(
    points: np.ndarray,
    poses: Poses,
    *,
    several: bool = False,
    region: str = "view",
    margin_fraction: float = 0.0,
    seed: int = 0,
) -> tuple[np.ndarray, dict]:
    """Choose the points above the ground that the cameras look at.

    Cloud (n_points, 3) and poses are aligned: z up, the ground near z = 0. The region ``view`` is
    what the cameras look at, down to the ground; ``cameras`` is the box of the cameras alone,
    whatever lies below. Of several trees it is the box of the cameras, which holds all that the
    walk goes along. The margin widens (or, negative, narrows) the region on each side by a fraction
    of its extent.

    Returns which points to keep, (n_points,) bool, and crop.json, all in the aligned frame:
    ``source`` of the region is ``region``, ``camera_box`` or ``cameras``, and ``center`` what the
    cameras look at. A `StageError` where the region holds no point.
    """
    search, warnings = thin_randomly(points, MOST_POINTS, seed), list[str]()
    center, distance, is_common = look_at_point(poses, search)
    if region == "cameras" and not several:
        source, footprint = "cameras", Footprint.of_box(poses.centers[:, :2])
    elif is_common and not several:
        source, footprint = "region", Footprint(center[:2], distance)
    else:
        # The paper's box, and as far before the cameras as they are from what they look at
        before = poses.centers + distance * poses.forward
        places = np.concatenate([poses.centers, before])
        source, footprint = "camera_box", Footprint.of_box(places[:, :2])
        if not several:
            warnings.append(
                "the cameras look at no common place: the region of interest is the box of the "
                "cameras and of what lies before them, as far as their distance to the middle of "
                "their view"
            )
    footprint = footprint.widened(margin_fraction)
    box, inside = footprint.limits(), footprint.inward(points[:, :2]) >= 0
    if not inside.any():
        limits = "x {:.3g} to {:.3g}, y {:.3g} to {:.3g}".format(*box.T.ravel())
        cause = f"the region of interest holds no point: {limits}"
        raise StageError(cause, key="crop.margin_fraction")
    if source == "cameras":
        floor = float(points[inside, 2].min())
    else:  # below the lowest ground inside as far as it may be off its plane
        cells = ground_cells(search, distance)
        low = cells[footprint.inward(cells[:, :2]) >= 0, 2]
        lowest = np.percentile(low, LOWEST_PERCENTILE) if len(low) else 0.0
        floor = float(min(lowest, 0.0) - AlignOptions.ground_distance_fraction * distance)
    keep = inside & (points[:, 2] >= floor)
    if not keep.any():
        cause = f"no point of the region of interest lies above z = {floor:.3g}; the cloud may be "
        cause += "upside down"
        raise StageError(cause, key="align.up_from")
    kept = int(keep.sum())
    logger.info(
        f"kept {kept:,} of {len(points):,} points ({kept / len(points):.1%}); "
        f"{inside.sum() - kept:,} more inside the region lie below z = {floor:.3g}"
    )
    for warning in warnings:
        logger.warning("%s", warning)
    return keep, {
        "center": center,
        "center_xy": footprint.center_xy,
        "radius": footprint.radius,
        "source": source,
        "camera_distance": distance,
        "box": {"x": box[:, 0], "y": box[:, 1], "z_min": floor},
        "n_points": len(points),
        "n_kept": kept,
        "warnings": warnings,
    }
