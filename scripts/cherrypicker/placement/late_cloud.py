"""Ready point clouds that enter the pipeline late: LiDAR scans, other people's photogrammetry."""

import logging
import os
from dataclasses import dataclass

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.geometry.directions import rodrigues
from cherrypicker.intake.clouds import read_ready_cloud
from cherrypicker.placement.footprint import NORMAL_SIZE
from cherrypicker.pointcloud import PointCloud
from cherrypicker.units import UNITS_M

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class HeightOptions:
    """What a metric cloud with a tree in it can be high: a config key of ``scale``."""

    height_range_m: tuple[float, float] = (0.1, 60.0)


def check_height(
    cloud: PointCloud, options: HeightOptions, where: str, file: str | os.PathLike | None = None
) -> None:
    """Refuse a metric cloud that is too high or too low for a tree: its unit is wrong, most likely.

    z is up; a cloud without a unit passes. The StageError names ``where``, the column or key that
    gave the unit.
    """
    if cloud.unit != "m" or len(cloud) == 0:
        return
    height = float(np.ptp(cloud.points[:, 2]))
    least, most = options.height_range_m
    if least >= most:
        raise StageError(f"no cloud is {least:g} to {most:g} m high", key="scale.height_range_m")
    if height > most:
        cause = f"more than {most:g} m"
    elif 0 < height < least:  # a cloud without height is refused by what it lacks
        cause = f"less than {least:g} m"
    else:
        return
    raise StageError(
        f"the cloud is {height:.3g} m high, and a tree of {cause} is not believed",
        file=file,
        key=f"{where}, or scale.height_range_m if the unit is right",
    )


def import_cloud(
    path: str | os.PathLike,
    unit: str = "",
    up: str = "",
    scale: str = "",
    heights: HeightOptions | None = None,
) -> PointCloud:
    """Read a ready cloud and bring it to metres and z up, in its own frame; points and order stay.

    The unit is ``m``, ``cm``, ``mm``, ``ft`` or metres per unit, and ``up`` the axis of the file
    that points up, ``-y`` or ``+X`` for instance; empty ones are m and z. A scale in metres per
    unit wins over the unit; ``none`` makes the cloud 3 high, unit ``arbitrary``. A `StageError`
    where the file is no good, or the cloud too high or too low for a tree.
    """
    cloud = read_ready_cloud(path)
    axis, upward = up or "z", np.zeros(3)
    upward["xyz".index(axis[-1].lower())] = -1.0 if axis.startswith("-") else 1.0
    rotation = rodrigues(upward)
    if scale == "none":
        height = float(np.ptp(cloud.points @ rotation[2]))
        if height <= 0:
            raise StageError("the cloud has no height to normalise", file=path, key="cloud_up")
        factor, new_unit = NORMAL_SIZE / height, "arbitrary"
    else:
        name = scale or unit or "m"
        factor, new_unit = float(UNITS_M.get(name, name)), "m"
    imported = cloud.transformed(scale=factor, rotation=rotation)
    imported.frame, imported.unit = "own", new_unit
    size = np.ptp(imported.points, axis=0)
    logger.info(
        "imported %s points, %.3g x %.3g x %.3g %s", f"{len(imported):,}", *size, imported.unit
    )
    column = "scale" if scale else "cloud_unit"
    check_height(imported, heights or HeightOptions(), f"{column} in trees.tsv", path)
    return imported
