"""Region of interest: the box of the camera positions, and which stem in it is the target.

The paper (section Region of Interest) takes the axis-aligned x/y box of the camera origins, on the
assumption that the cameras stand around the tree. Where they do not (photos from one side only) the
camera origins are mirrored at the target, so that the box encloses it all the same.
"""

import logging
from dataclasses import dataclass

import numpy as np

from cherrypicker.camera_geometry import look_at_point
from cherrypicker.errors import StageError
from cherrypicker.ground import GroundSurface, ground_cells
from cherrypicker.stems import find_stems

logger = logging.getLogger(__name__)

_SEARCH_POINTS = 400_000
# The ground is kept for the segmentation; what lies deeper under it is noise.
_DEPTH_BELOW_GROUND = 0.05
# Cameras all around a target leave no gap in azimuth wider than this.
_WIDEST_GAP_DEG = 170.0
# Stems nearer to the target than this, in camera distances, are its own.
_SAME_TREE = 0.12


@dataclass
class Crop:
    """Result of :func:`crop_roi`.

    Attributes
    ----------
    keep : ndarray of shape (n_points,), bool
    report : dict
        As written to crop.json: target, box, stems, counts, warnings.
    """

    keep: np.ndarray
    report: dict


def crop_roi(points, poses, *, margin_fraction=0.0, target_xy=None, seed=0):
    """Choose the points inside the box of the cameras, and the target tree.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Aligned cloud, z up, ground near z = 0.
    poses : Poses
        Aligned poses.
    margin_fraction : float, default 0
        Widens (or, negative, narrows) the box on each side by this fraction of its extent.
    target_xy : sequence of 2 float, optional
        Where the target's stem stands, aligned frame; else the stem nearest the point that the
        cameras look at.
    seed : int, default 0

    Returns
    -------
    Crop

    Raises
    ------
    StageError
        If the box holds no point, or `target_xy` lies outside the cloud.
    """
    search = _thin_randomly(points, seed)
    look_at, distance = look_at_point(poses, search)
    cells = ground_cells(search, 0.1 * distance, 2.5 * distance, 0.3 * distance)
    surface = GroundSurface(cells)
    stems = find_stems(search, look_at[:2], distance, surface)
    warnings = []
    target, source, stem = _choose_target(search, stems, look_at, distance, target_xy, warnings)
    box = camera_box(poses.centers, target, margin_fraction, distance, warnings)
    in_box = _in_box(points, box)
    floor = _floor(surface, cells, points[in_box], distance)
    keep = _above_floor(points, in_box, floor)
    beside = [s for s in stems if s is not stem and _inside(s, box)]
    others = _other_trees(beside, target, distance, warnings)
    kept = int(keep.sum())
    logger.info(
        "kept %s of %s points (%.1f %%); %s more inside the box lie below z = %.3g",
        f"{kept:,}",
        f"{len(points):,}",
        100 * kept / len(points),
        f"{int(in_box.sum()) - kept:,}",
        floor,
    )
    for warning in warnings:
        logger.warning("%s", warning)
    report = {
        "target_xy": list(target),
        "target_source": source,
        "stem": None if stem is None else stem.as_dict(),
        "other_stems": [other.as_dict() for other in others],
        "posts": [other.as_dict() for other in beside if other not in others],
        "look_at": look_at,
        "camera_distance": distance,
        "box": {"x": box[:, 0], "y": box[:, 1], "z_min": floor},
        "n_points": len(points),
        "n_kept": kept,
        "warnings": warnings,
    }
    return Crop(keep, report)


def camera_box(centers, target, margin_fraction, distance, warnings):
    """Axis-aligned x/y box of the camera centres that encloses the target.

    Parameters
    ----------
    centers : ndarray of shape (n_cameras, 3)
    target : array-like of shape (2,)
    margin_fraction : float
    distance : float
        Cameras' median distance to what they look at.
    warnings : list of str
        Gets a line when the cameras do not surround the target.

    Returns
    -------
    ndarray of shape (2, 2)
        Lower and upper corner.
    """
    spots = np.asarray(centers)[:, :2]
    offsets = spots - target
    azimuths = np.sort(np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])))
    gap = np.diff(azimuths, append=azimuths[0] + 360).max()
    if gap > _WIDEST_GAP_DEG:
        warnings.append(
            f"the photos leave {gap:.0f} degrees around the target unseen: the region of interest "
            "is the box of the cameras and of their mirror images at the target"
        )
        spots = np.concatenate([spots, target - offsets])
    lower, upper = spots.min(axis=0), spots.max(axis=0)
    # A row of photos on each side of a tree row leaves a slit that would cut the crown.
    reach = 0.5 * distance
    if (lower > target - reach).any() or (upper < target + reach).any():
        warnings.append(
            "the cameras leave less than half their distance on a side of the target: the region "
            "of interest is widened to that"
        )
        lower, upper = np.minimum(lower, target - reach), np.maximum(upper, target + reach)
    margin = margin_fraction * (upper - lower)
    return np.stack([lower - margin, upper + margin])


def _thin_randomly(points, seed):
    """At most `_SEARCH_POINTS` points: enough to find ground and stems."""
    if len(points) <= _SEARCH_POINTS:
        return points
    chosen = np.random.default_rng(seed).choice(len(points), _SEARCH_POINTS, replace=False)
    return points[np.sort(chosen)]


def _in_box(points, box):
    """Mask of the points in the box; refuse when there are none."""
    in_box = np.all((points[:, :2] >= box[0]) & (points[:, :2] <= box[1]), axis=1)
    if not in_box.any():
        raise StageError(
            "the region of interest holds no point: x {:.3g} to {:.3g}, y {:.3g} to {:.3g}".format(
                *box.T.ravel()
            ),
            key="crop.margin_fraction",
        )
    return in_box


def _above_floor(points, in_box, floor):
    """Mask of the points in the box that are not below the ground; refuse when there are none."""
    keep = in_box & (points[:, 2] >= floor)
    if not keep.any():
        raise StageError(
            f"no point of the region of interest lies above z = {floor:.3g}; the cloud may be "
            "upside down",
            key="align.up_from",
        )
    return keep


def _other_trees(stems, target, distance, warnings):
    """Stems with a crown that stand apart from the target; each gets a warning."""
    others = []
    for other in stems:
        apart = np.hypot(other.x - target[0], other.y - target[1]) / distance
        if not other.has_crown or apart <= _SAME_TREE:
            continue
        others.append(other)
        warnings.append(
            f"another stem stands in the region of interest at x {other.x:.3g}, y {other.y:.3g}, "
            f"{apart:.2f} camera distances from the target; crop.target_xy chooses between them"
        )
    return others


def _choose_target(points, stems, look_at, distance, target_xy, warnings):
    """Target x, y, where it comes from, and its stem if one was found."""
    if target_xy is not None:
        target = np.asarray(target_xy, float)
        if target.shape != (2,) or not np.isfinite(target).all():
            raise StageError(f"{target_xy!r} is no pair of numbers", key="crop.target_xy")
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        if (target < low).any() or (target > high).any():
            raise StageError(
                f"the point ({target[0]:g}, {target[1]:g}) lies outside the aligned cloud",
                key="crop.target_xy",
            )
        nearest = min(stems, key=lambda s: np.hypot(s.x - target[0], s.y - target[1]), default=None)
        if nearest is not None:
            apart = np.hypot(nearest.x - target[0], nearest.y - target[1])
            nearest = nearest if apart < max(3 * nearest.radius, 0.1 * distance) else None
        if nearest is None:
            warnings.append("no stem was found at crop.target_xy; the point is used as it is")
        return target, "config", nearest
    if stems:
        return np.array([stems[0].x, stems[0].y]), "stem", stems[0]
    warnings.append("no stem found: the target is the point that the cameras look at")
    return look_at[:2].copy(), "look_at", None


def _floor(surface, cells, points, distance):
    """Lowest height kept: a little below the lowest ground inside the box."""
    margin = _DEPTH_BELOW_GROUND * distance
    if len(cells) == 0:
        return float(np.percentile(points[:, 2], 0.1) - margin)
    spots = points[:: max(1, len(points) // 20_000), :2]
    return float(min(np.percentile(surface(spots), 1), 0.0) - margin)


def _inside(stem, box):
    return bool(box[0, 0] <= stem.x <= box[1, 0] and box[0, 1] <= stem.y <= box[1, 1])
