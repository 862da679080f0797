"""Region of interest: of the cloud, what stands on the ground that the cameras look at.

The paper (section Region of Interest) takes the axis-aligned x/y box of the camera origins, on the
assumption that the cameras stand around the tree: the option region "cameras". The default keeps
the vertical shadow of the region of :mod:`cherrypicker.placement.region`, which is as wide and
needs no such assumption. Which tree in
it is the target is decided once, after the labels (:mod:`cherrypicker.wood.target`). Of a scan of
several trees none stands in the middle, and the paper's box it is.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.placement.footprint import Footprint
from cherrypicker.placement.ground import LOWEST_PERCENTILE, MOST_POINTS, ground_cells
from cherrypicker.placement.region import find_region, look_at_point
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)

# The ground is kept for the segmentation; what lies deeper under it is noise (guess)
_DEPTH = 0.05


@dataclass
class Crop:
    """Result of :func:`crop_roi`."""

    keep: np.ndarray  # (n_points,) bool
    # As written to crop.json, all in the aligned frame: ``center`` (what the cameras look at),
    # ``center_xy`` and ``radius`` of the region, ``source`` (a `Footprint`'s origin: ``region``,
    # ``camera_box`` or ``cameras``),
    # ``camera_distance``, ``box`` (``x`` and ``y`` limits, ``z_min``), ``n_points``, ``n_kept``,
    # ``warnings``
    report: dict


def crop_roi(
    points: np.ndarray,
    poses: Poses,
    *,
    several: bool = False,
    region: str = "view",
    margin_fraction: float = 0.0,
    seed: int = 0,
) -> Crop:
    """Choose the points above the ground that the cameras look at.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Aligned cloud, z up, ground near z = 0.
    poses : Poses
        Aligned poses.
    several : bool, default False
        The scan is of several trees: the region is the box of the cameras, which holds all that the
        walk goes along.
    region : {"view", "cameras"}
        What the cameras look at, down to the ground; or the box of the cameras alone, whatever lies
        below (not of several trees).
    margin_fraction : float, default 0
        Widens (or, negative, narrows) the region on each side by this fraction of its extent.

    Raises
    ------
    StageError
        If the region holds no point.
    """
    search = thin_randomly(points, MOST_POINTS, seed)
    is_box = region == "cameras" and not several
    center, distance, footprint, warnings = _footprint(poses, search, several, is_box)
    footprint = footprint.widened(margin_fraction)
    inside = footprint.inward(points[:, :2]) >= 0
    if not inside.any():
        raise StageError(
            "the region of interest holds no point: x {:.3g} to {:.3g}, y {:.3g} to {:.3g}".format(
                *footprint.limits().T.ravel()
            ),
            key="crop.margin_fraction",
        )
    floor = float(points[inside, 2].min()) if is_box else _floor(search, footprint, distance)
    keep = inside & (points[:, 2] >= floor)
    if not keep.any():
        raise StageError(
            f"no point of the region of interest lies above z = {floor:.3g}; the cloud may be "
            "upside down",
            key="align.up_from",
        )
    kept = int(keep.sum())
    logger.info(
        "kept %s of %s points (%.1f %%); %s more inside the region lie below z = %.3g",
        f"{kept:,}",
        f"{len(points):,}",
        100 * kept / len(points),
        f"{int(inside.sum()) - kept:,}",
        floor,
    )
    for warning in warnings:
        logger.warning("%s", warning)
    box = footprint.limits()
    report = {
        "center": center,
        "center_xy": footprint.center_xy,
        "radius": footprint.radius,
        "source": "cameras" if is_box else "region" if footprint.box is None else "camera_box",
        "camera_distance": distance,
        "box": {"x": box[:, 0], "y": box[:, 1], "z_min": floor},
        "n_points": len(points),
        "n_kept": kept,
        "warnings": warnings,
    }
    return Crop(keep, report)


def _footprint(
    poses: Poses, points: np.ndarray, several: bool, is_box: bool
) -> tuple[np.ndarray, float, Footprint, list[str]]:
    """What the cameras look at, their distance to it, its footprint, and warnings."""
    if is_box:
        center, distance = look_at_point(poses, points)
        xy = poses.centers[:, :2]
        return center, distance, Footprint.of_box(np.stack([xy.min(axis=0), xy.max(axis=0)])), []
    region = None if several else find_region(poses)
    if region is not None:
        return region.center, region.distance, Footprint(region.center[:2], region.radius), []
    center, distance = look_at_point(poses, points)
    # The paper's box, and as far before the cameras as they are from what they look at.
    spots = np.concatenate([poses.centers, poses.centers + distance * poses.forward])[:, :2]
    warning = (
        "the cameras look at no common place: the region of interest is the box of the cameras "
        "and of what lies before them, as far as their distance to the middle of their view"
    )
    footprint = Footprint.of_box(np.stack([spots.min(axis=0), spots.max(axis=0)]))
    return center, distance, footprint, [] if several else [warning]


def _floor(points: np.ndarray, footprint: Footprint, distance: float) -> float:
    """Lowest height kept: a little below the lowest ground inside the region."""
    cells = ground_cells(points, distance)
    cells = cells[footprint.inward(cells[:, :2]) >= 0]
    heights = cells[:, 2] if len(cells) else points[footprint.inward(points[:, :2]) >= 0, 2]
    lowest = np.percentile(heights, LOWEST_PERCENTILE) if len(heights) else 0.0
    return float(min(lowest, 0.0) - _DEPTH * distance)
