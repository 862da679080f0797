"""A finished scan of a series, from the files of its results folder."""

from pathlib import Path

from cherrypicker.classes import wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import is_number, read_json
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.pointcloud import read_cloud
from cherrypicker.series.compare import Scan
from cherrypicker.series.frame import marker_corners
from cherrypicker.series.wood import sample_wood
from cherrypicker.traits.branches import read_branches
from cherrypicker.traits.reports import Reports

_NUMBERS = ("parent_id", "order", "length_m", "base_diameter_m", "base_height_m")
_MAYBE = ("base_diameter_low_m", "base_diameter_high_m")


def read_scan(folder: str | Path, tree: str, date: str) -> Scan:
    """Read a scan from ``results/{tree}``.

    A `StageError` where a file is missing or broken, the scan has no date or no scale, or its
    tables do not belong to its skeleton.
    """
    folder = Path(folder)
    if not date:
        raise StageError(f"tree {tree} of the series has no date", key="date in trees.tsv")
    found = read_measured_tree(folder)
    if found.skeleton.unit != "m":
        raise StageError(
            f"tree {tree} has no scale, so that its lengths compare with no other's",
            file=folder / "skeleton.graphml",
            key="scale in trees.tsv",
        )
    wood = sample_wood(found.skeleton, found.axis_list)
    branches = [dict.fromkeys(_MAYBE) | row for row in read_branches(folder / "branches.csv")]
    for row in branches:
        told = {name: row.get(name) for name in _NUMBERS}
        told |= {name: row[name] for name in _MAYBE if row[name] is not None}
        for name, value in told.items():
            if not is_number(value):
                cause = f"branch {row.get('branch_id')} has no finite number as its {name}: {value}"
                raise StageError(cause, file=folder / "branches.csv")
    cloud = read_cloud(folder / "segmented.ply", required=("label",))
    points = cloud.points[wood_mask(cloud["label"])]
    scale, align = (
        read_json(path) if (path := folder / name).is_file() else {}
        for name in ("scale.json", "align.json")
    )
    markers = marker_corners(scale, align) if scale and align else {}
    return Scan(tree, date, wood, branches, points, markers, Reports(scale=scale).scale_error)
