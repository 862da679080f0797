"""Ready clouds as scanners and other programs leave them: PLY, LAS, LAZ and text."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.intake.las_promise import check_las_promise
from cherrypicker.pointcloud import PointCloud, read_cloud

_LAS_POINTS_AT_A_TIME = 500_000  # some 20 MB; a header that promises more takes none for it


def read_ready_cloud(path: str | os.PathLike) -> PointCloud:
    """Read a PLY, LAS or LAZ file, or text of ``x y z [r g b]`` rows, with its labels if any.

    Raises
    ------
    StageError
        Naming file and column if the file is missing, unreadable, empty or not finite, or its
        labels are out of range.
    """
    try:
        return _read(Path(path))
    except StageError as error:
        raise StageError(error.cause, file=path, key="cloud in trees.tsv") from error


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
