"""A finished scan of a series, from the files of its results folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cherrypicker.classes import wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import cell_number, is_number, read_json, read_table
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.series.compare import Scan
from cherrypicker.series.marker_frames import marker_corners
from cherrypicker.series.wood import Wood, sample_wood
from cherrypicker.skeleton import read_skeleton

_NUMBERS = ("parent_id", "order", "length_m", "base_diameter_m", "base_height_m")
_MAYBE = ("base_diameter_low_m", "base_diameter_high_m", "mean_diameter_m")
_MARKER_FILES = ("scale.json", "poses.npz", "metric_poses.npz")


def read_scan(folder: str | Path, tree: str, date: str) -> Scan:
    """Read a scan.

    Parameters
    ----------
    folder : path-like
        ``results/{tree}``.
    tree, date : str

    Raises
    ------
    StageError
        If a file is missing or broken, the scan has no date or no scale, or its tables do not
        belong to its skeleton.
    """
    folder = Path(folder)
    if not date:
        raise StageError(f"tree {tree} of the series has no date", key="date in trees.tsv")
    skeleton = read_skeleton(folder / "skeleton.graphml")
    if skeleton.unit != "m":
        raise StageError(
            f"tree {tree} has no scale, so that its lengths compare with no other's",
            file=folder / "skeleton.graphml",
            key="scale in trees.tsv",
        )
    wood = sample_wood(skeleton)
    branches = _branches(folder / "branches.csv")
    if len(branches) != wood.axis.max() + 1:
        raise StageError(
            f"{len(branches)} rows for {wood.axis.max() + 1} axes of the skeleton",
            file=folder / "branches.csv",
        )
    _use_measured_diameters(wood, branches)
    cloud = read_cloud(folder / "segmented.ply", required=("label",))
    points = cloud.points[wood_mask(cloud["label"])]
    return Scan(tree, date, wood, branches, points, _markers(folder), _scale_error(folder))


def _branches(path: Path) -> list[dict]:
    rows = []
    for line, cells in read_table(path, _NUMBERS):
        row: dict = {name: cell_number(cells[name], path, line) for name in _NUMBERS}
        for name in _MAYBE:
            text = cells.get(name)
            row[name] = cell_number(text, path, line) if text else None
        rows.append(row)
    return rows


def _use_measured_diameters(wood: Wood, branches: list[dict]) -> None:
    """Scale the radii of each axis to the mean diameter of its row, which photos may have told."""
    length = np.maximum(np.bincount(wood.axis, wood.length), 1e-9)
    own = np.bincount(wood.axis, 2.0 * wood.radius * wood.length) / length
    told = np.array([row["mean_diameter_m"] or mean for row, mean in zip(branches, own)])
    wood.radius *= np.where(own > 0, told / np.maximum(own, 1e-9), 1.0)[wood.axis]


def _scale_error(folder: Path) -> float:
    """Relative standard error of a scan's scale; 0 of a ready cloud, and where none is known."""
    path = folder / "scale.json"
    told = read_json(path) if path.is_file() else {}
    scale, error = told.get("scale"), told.get("scale_std")
    return float(error / scale) if is_number(scale) and scale and is_number(error) else 0.0


def _markers(folder: Path) -> dict:
    """Corners of a scan's markers; none where it has no such files."""
    paths = [folder / name for name in _MARKER_FILES]
    if not all(path.is_file() for path in paths):
        return {}
    return marker_corners(read_json(paths[0]), read_poses(paths[1]), read_poses(paths[2]))
