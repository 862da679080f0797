"""Ready clouds that enter late, as scanners and other programs leave them: PLY, LAS, LAZ, text."""

import logging
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.geometry.directions import rodrigues
from cherrypicker.intake.las_promise import check_las_promise
from cherrypicker.pointcloud import PointCloud, read_cloud
from cherrypicker.units import NORMAL_SIZE, UNITS_M

logger = logging.getLogger(__name__)

_LAS_POINTS_AT_A_TIME = 500_000  # some 20 MB; a header that promises more takes none for it


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

    It is a PLY, LAS or LAZ file, or text of ``x y z [r g b]`` rows, with its labels if any. The
    unit is ``m``, ``cm``, ``mm``, ``ft`` or metres per unit, and ``up`` the axis of the file that
    points up, ``-y`` or ``+X`` for instance; empty ones are m and z. A scale in metres per unit
    wins over the unit; ``none`` makes the cloud 3 high, unit ``arbitrary``.

    A `StageError`, naming file and column, where the file is missing, unreadable, empty or not
    finite, its labels are out of range, or the cloud is too high or too low for a tree.
    """
    try:
        cloud = _read(Path(path))
    except StageError as error:
        raise StageError(error.cause, file=path, key="cloud in trees.tsv") from error
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


def _read(path: Path) -> PointCloud:
    """A cloud that can be gone on with; what is wrong with another is told without its file."""
    if not path.is_file():
        raise StageError("the point cloud is missing")
    read = _READERS.get(path.suffix.lower())
    if read is None:
        raise StageError(f"unknown kind of point cloud {path.suffix!r} ({', '.join(_READERS)})")
    cloud = read(path)
    if len(cloud) == 0:
        raise StageError("the point cloud is empty")
    if not np.isfinite(cloud.points).all():
        raise StageError("the point cloud has coordinates that are not finite")
    if "label" in cloud:
        labels, valid = cloud["label"], [int(label) for label in Label]
        wrong = labels[~np.isin(labels, valid)]
        if len(wrong):
            said = f"{len(wrong):,} of {len(cloud):,} labels are none of {valid}"
            raise StageError(f"{said}, the first is {wrong[0]}")
        cloud.fields["label"] = labels.astype(np.uint8)
        if "confidence" not in cloud:
            cloud.fields["confidence"] = np.ones(len(cloud), dtype=np.float32)
    return cloud


def _read_las(path: Path) -> PointCloud:
    import laspy

    points, levels = [], []
    try:
        check_las_promise(path)
        # One chunk after another, point by point: the parallel decoder makes room for as many
        # points as the file calls a chunk, and on two cores it is hardly faster (3 million
        # points in 0.62 s, this one in 0.68 s)
        with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs, read_evlrs=False) as reader:
            names = set(reader.header.point_format.dimension_names)
            has_colors = {"red", "green", "blue"} <= names
            for piece in reader.chunk_iterator(_LAS_POINTS_AT_A_TIME):
                points.append(np.column_stack([piece.x, piece.y, piece.z]).astype(np.float64))
                if has_colors:
                    levels.append(np.column_stack([piece.red, piece.green, piece.blue]))
    except (StageError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # laspy and lazrs share no base class, a panic of Rust has none
        raise StageError(f"not a readable LAS/LAZ file ({error})") from error
    colors = None
    rgb = np.concatenate(levels).astype(np.float32) if levels else np.zeros((0, 3), np.float32)
    if rgb.size and rgb.max() > 0:
        colors = rgb / np.iinfo(np.uint16 if rgb.max() > 255 else np.uint8).max
    return PointCloud(np.concatenate([np.empty((0, 3)), *points]), colors)


def _read_text(path: Path) -> PointCloud:
    with open(path, encoding="utf-8-sig", errors="replace") as stream:
        lines = [stream.readline() for _ in range(3)]
    delimiter = next((mark for mark in ",;" if mark in "".join(lines)), None)
    n_header = next((i for i, line in enumerate(lines) if _is_point(line, delimiter)), None)
    if n_header is None:
        raise StageError("not rows of x y z numbers")
    try:
        table = np.loadtxt(
            path, delimiter=delimiter, skiprows=n_header, ndmin=2, encoding="utf-8-sig"
        )
    except (ValueError, UnicodeDecodeError) as error:
        raise StageError(f"not rows of x y z numbers ({error})") from error
    colors = None
    if table.shape[1] >= 6:
        rgb = table[:, 3:6]
        if rgb.min() >= 0 and rgb.max() <= 255:
            colors = rgb / (255 if rgb.max() > 1 else 1.0)
    return PointCloud(table[:, :3], colors)


def _is_point(line: str, delimiter: str | None) -> bool:
    cells = line.split(delimiter)
    try:
        return len([float(cell) for cell in cells[:3]]) == 3
    except ValueError:
        return False


_READERS: dict[str, Callable[[Path], PointCloud]] = {
    ".ply": read_cloud,
    **dict.fromkeys((".las", ".laz"), _read_las),
    **dict.fromkeys((".xyz", ".txt", ".asc", ".csv", ".pts"), _read_text),
}
