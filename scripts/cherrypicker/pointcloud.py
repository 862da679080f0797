"""Point clouds in memory and as binary PLY."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.ply import PlyError, read_ply_vertices, write_ply_vertices

_COLOR_NAMES = ("red", "green", "blue")
_NORMAL_NAMES = ("nx", "ny", "nz")
_FLOAT32_TOLERANCE = 1e-5


@dataclass
class PointCloud:
    """Points with optional colours, normals and named per-point fields."""

    points: np.ndarray  # (n_points, 3) float64: coordinates in ``frame`` and ``unit``
    # ndarray of shape (n_points, 3), float32, or None: RGB in [0, 1]
    colors: np.ndarray | None = None
    normals: np.ndarray | None = None  # ndarray of shape (n_points, 3), float32, or None
    # dict of str to ndarray of shape (n_points,): ``label`` (uint8), ``confidence`` (float32),
    # ``source`` (int32), ``n_views`` (uint8), ...
    fields: dict[str, np.ndarray] = field(default_factory=dict)
    frame: str = "own"  # ``colmap``, ``aligned``, ``metric`` or ``own`` (a late cloud's)
    unit: str = "m"  # ``m`` or ``arbitrary``

    def __post_init__(self) -> None:
        self.points = _rows_of_three("points", self.points, np.float64)
        n_points = len(self.points)
        for name in ("colors", "normals"):
            value = getattr(self, name)
            if value is not None:
                value = _rows_of_three(name, value, np.float32)
                if len(value) != n_points:
                    raise ValueError(f"{name} must have {n_points} rows, got {len(value)}")
                setattr(self, name, value)
        self.fields = {name: np.asarray(values) for name, values in self.fields.items()}
        for name, values in self.fields.items():
            if values.shape != (n_points,):
                raise ValueError(f"{name} must have shape ({n_points},), got {values.shape}")

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.fields[name]

    def __contains__(self, name: str) -> bool:
        return name in self.fields

    def select(self, index: np.ndarray) -> PointCloud:
        """Return the points of a boolean mask or an index array, with all that belongs to them."""
        return replace(
            self,
            points=self.points[index],
            colors=None if self.colors is None else self.colors[index],
            normals=None if self.normals is None else self.normals[index],
            fields={name: values[index] for name, values in self.fields.items()},
        )

    def with_fields(self, **fields: np.ndarray) -> PointCloud:
        """Return a copy that has these fields besides its own."""
        return replace(self, fields={**self.fields, **fields})

    def transformed(
        self,
        scale: float = 1.0,
        rotation: np.ndarray | None = None,
        translation: npt.ArrayLike = (0.0, 0.0, 0.0),
    ) -> PointCloud:
        """Return the cloud under ``x' = scale * R x + t``; normals are rotated along."""
        rotation = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
        points = scale * self.points @ rotation.T + np.asarray(translation, dtype=np.float64)
        normals = None if self.normals is None else self.normals @ rotation.T.astype(np.float32)
        return replace(self, points=points, normals=normals)


def joined(clouds: Sequence[PointCloud]) -> PointCloud:
    """One cloud of several, with what all have beside points; the first one's frame and unit."""

    def all_of(values: list) -> np.ndarray | None:
        return None if any(each is None for each in values) else np.concatenate(values)

    first = clouds[0]
    return PointCloud(
        np.concatenate([cloud.points for cloud in clouds]),
        all_of([cloud.colors for cloud in clouds]),
        all_of([cloud.normals for cloud in clouds]),
        {
            name: np.concatenate([cloud[name] for cloud in clouds])
            for name in first.fields
            if all(name in cloud for cloud in clouds)
        },
        frame=first.frame,
        unit=first.unit,
    )


def read_cloud(
    path: str | os.PathLike, required: tuple[str, ...] = (), *, may_be_empty: bool = False
) -> PointCloud:
    """Read a PLY cloud of any of the three encodings.

    Parameters
    ----------
    required : tuple of str
        Fields that must be there, ``("label",)`` for instance; ``"colors"`` and ``"normals"`` name
        the colours and normals.
    may_be_empty : bool, default False
        A cloud without points is no error.

    Raises
    ------
    StageError
        If the file is missing, no PLY, has no point, a coordinate that is not finite, or lacks a
        required field.
    """
    try:
        columns, comments = read_ply_vertices(path)
    except FileNotFoundError as error:
        raise StageError("the point cloud is missing", file=path) from error
    except PlyError as error:
        raise StageError(str(error), file=path) from error
    cloud = _cloud_from_columns(columns, comments, path)
    if len(cloud) == 0 and not may_be_empty:
        raise StageError("the point cloud is empty", file=path)
    if not np.isfinite(cloud.points).all():
        bad = int((~np.isfinite(cloud.points).all(axis=1)).sum())
        raise StageError(f"{bad:,} of {len(cloud):,} points are not finite", file=path)
    for name in required:
        absent = (
            getattr(cloud, name) is None if name in ("colors", "normals") else name not in cloud
        )
        if absent:
            raise StageError(f"the point cloud has no {name}", file=path)
    return cloud


def write_cloud(
    path: str | os.PathLike,
    cloud: PointCloud,
    edges: np.ndarray | None = None,
    *,
    may_be_empty: bool = False,
) -> None:
    """Write a cloud as binary little-endian PLY, atomically; with edges of its points, (n, 2) int.

    Coordinates are float32 unless that would move a point by more than 1e-5 units, colours uchar,
    normals float32; the header carries ``comment frame=... unit=...``.

    Raises
    ------
    StageError
        If the cloud is empty and may not be: an empty result is never passed on.
    """
    if len(cloud) == 0 and not may_be_empty:
        raise StageError("nothing to write: the point cloud is empty", file=path)
    as_float32 = cloud.points.astype(np.float32)
    is_exact = np.abs(as_float32 - cloud.points).max(initial=0.0) <= _FLOAT32_TOLERANCE
    points = as_float32 if is_exact else cloud.points
    columns = dict(zip("xyz", points.T))
    if cloud.normals is not None:
        columns.update(zip(_NORMAL_NAMES, cloud.normals.astype(np.float32).T))
    if cloud.colors is not None:
        rgb = np.clip(np.rint(cloud.colors * 255.0), 0, 255).astype(np.uint8)
        columns.update(zip(_COLOR_NAMES, rgb.T))
    columns.update(cloud.fields)
    header = f"frame={cloud.frame} unit={cloud.unit}"
    with atomic_path(path) as temporary:
        write_ply_vertices(temporary, columns, [header], edges)


def _cloud_from_columns(columns: dict, comments: list[str], path: str | os.PathLike) -> PointCloud:
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        raise StageError(f"the vertices have no {', '.join(missing)}", file=path)
    points = np.column_stack([columns.pop(name) for name in "xyz"]).astype(np.float64)
    colors = normals = None
    if all(name in columns for name in _COLOR_NAMES):
        rgb = np.column_stack([columns.pop(name) for name in _COLOR_NAMES])
        is_integer = np.issubdtype(rgb.dtype, np.integer)
        colors = rgb.astype(np.float32) / (np.iinfo(rgb.dtype).max if is_integer else 1.0)
    if all(name in columns for name in _NORMAL_NAMES):
        normals = np.column_stack([columns.pop(name) for name in _NORMAL_NAMES])
    meta = dict(word.split("=", 1) for line in comments for word in line.split() if "=" in word)
    frame, unit = meta.get("frame", "own"), meta.get("unit", "m")
    return PointCloud(points, colors, normals, columns, frame=frame, unit=unit)


def _rows_of_three(name: str, values: np.ndarray, dtype: type) -> np.ndarray:
    values = np.ascontiguousarray(values, dtype=dtype)
    if values.ndim != 2 or values.shape[1] != 3:
        raise ValueError(f"{name} must have shape (N, 3), got {values.shape}")
    return values
