"""Bring the cloud and the poses to metres, or to a normalised size where no scale is known."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import is_number
from cherrypicker.markers.columns import CAMERA_DISTANCE_M
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)

# The cameras' median distance to the centre of the region of interest without a scale: about that
# of a real scan, so that lengths meant in metres still make sense (guess)
_NORMAL_DISTANCE = 3.0
_PLAUSIBLE_HEIGHT_M = (0.15, 40.0)  # of a cloud (guess)
_TOP_PERCENTILE = 99.9  # of the heights: what stands for its top


def scale_scene(
    cloud: PointCloud, poses: Poses, scale_report: dict, crop_report: dict
) -> tuple[PointCloud, Poses, dict]:
    """Scale the aligned scene about its origin.

    Parameters
    ----------
    cloud : PointCloud
        Denoised cloud, aligned frame.
    poses : Poses
        Aligned frame.
    scale_report : dict
        scale.json: ``mode``, ``scale`` in metres per unit, ``unit``.
    crop_report : dict
        crop.json: the region of interest and ``camera_distance``.

    Returns
    -------
    cloud : PointCloud
        Metric frame; unit ``m``, or ``arbitrary`` without a scale.
    poses : Poses
    report : dict
        Content of metric.json: ``unit``, ``factor`` (from the aligned frame), ``scale_mode``, and
        in the metric frame ``camera_distance`` and ``region`` (see
        :class:`cherrypicker.placement.footprint.Footprint`).

    Raises
    ------
    StageError
        If the scale is missing, or implies cameras impossibly near or far.
    """
    unit, factor = scale_report.get("unit", "arbitrary"), scale_report.get("scale")
    distance = crop_report["camera_distance"]
    if not (is_number(distance) and distance > 0):
        raise StageError(f"crop.json holds no distance of the cameras ({distance})", key="crop")
    if scale_report.get("mode") == "none":
        factor = _NORMAL_DISTANCE / distance
        logger.info("no scale: the cameras' median distance is set to %g units", _NORMAL_DISTANCE)
    elif not (is_number(factor) and factor > 0):
        raise StageError(f"scale.json holds no usable scale ({factor})", key="scale in trees.tsv")
    else:
        _check_plausible(cloud.points, factor, distance)
    scaled = replace(cloud.transformed(factor), frame="metric", unit=unit)
    report = {
        "unit": unit,
        "factor": factor,
        "scale_mode": scale_report.get("mode"),
        "camera_distance": factor * distance,
        "region": Footprint.from_dict(crop_report).scaled(factor).as_dict(),
    }
    return scaled, poses.transformed(factor), report


def _check_plausible(points: np.ndarray, factor: float, distance: float) -> None:
    """Refuse or question a scale by what it makes of the cameras and of the cloud's height."""
    low, high = CAMERA_DISTANCE_M
    if not low <= factor * distance <= high:
        raise StageError(
            f"with {factor:.4g} metres per unit the cameras stand {factor * distance:.3g} m from "
            "the tree, outside what a tree is photographed from",
            key="scale or marker_sides_m in trees.tsv",
        )
    height = factor * float(np.percentile(points[:, 2], _TOP_PERCENTILE))
    logger.info("height of the cloud %.2f m, camera distance %.2f m", height, factor * distance)
    if not _PLAUSIBLE_HEIGHT_M[0] <= height <= _PLAUSIBLE_HEIGHT_M[1]:
        logger.warning(
            "the cloud is %.3g m tall, which is odd for a tree; check scale or marker_sides_m in "
            "trees.tsv",
            height,
        )
