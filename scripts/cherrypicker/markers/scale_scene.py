"""Bring the cloud and the poses to metres, or to a normalised size where no scale is known."""

import logging
from dataclasses import replace

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import is_number
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.poses import Poses
from cherrypicker.units import NORMAL_SIZE

logger = logging.getLogger(__name__)


def scale_scene(
    cloud: PointCloud, poses: Poses, scale_report: dict, crop_report: dict
) -> tuple[PointCloud, Poses, dict]:
    """Scale the denoised cloud and the poses, aligned frame, about the origin.

    Of scale.json ``mode``, ``scale`` in metres per unit and ``unit`` are read, of crop.json the
    region of interest and ``camera_distance``. Cloud and poses come in the metric frame, their unit
    ``m``, or ``arbitrary`` without a scale. The report is the content of metric.json: ``unit``,
    ``scale_mode``, the ``factor`` from the aligned frame, and in the metric one
    ``camera_distance``, the size of a photo's ``pixel`` there and ``region``.

    Raises
    ------
    StageError
        If the scale is missing.
    """
    unit, factor = scale_report.get("unit", "arbitrary"), scale_report.get("scale")
    distance = crop_report["camera_distance"]
    if not (is_number(distance) and distance > 0):
        raise StageError(f"crop.json holds no distance of the cameras ({distance})", key="crop")
    if scale_report.get("mode") == "none":
        factor = NORMAL_SIZE / distance
    elif not (is_number(factor) and factor > 0):
        raise StageError(f"scale.json holds no usable scale ({factor})", key="scale in trees.tsv")
    logger.info("the cameras stand %.2f %s from the tree", factor * distance, unit)
    scaled = replace(cloud.transformed(factor), frame="metric", unit=unit)
    report = {
        "unit": unit,
        "factor": factor,
        "scale_mode": scale_report.get("mode"),
        "camera_distance": factor * distance,
        "pixel": factor * distance / float(np.median(poses.K[:, 0, 0])),
        "region": Footprint.from_dict(crop_report).scaled(factor).as_dict(),
    }
    return scaled, poses.transformed(factor), report
