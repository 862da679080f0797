"""One row an axis: length, chord, diameters, insertion angle, azimuth, height of its base.

An axis leaves its parent inside the parent's wood and a contracted skeleton bends there, so
directions and base diameters are taken beyond the parent's surface.
"""

import csv
import os
from collections.abc import Mapping
from itertools import compress
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import csv_text
from cherrypicker.geometry.lines import NEAR, Line
from cherrypicker.skeleton.axes import Axis
from cherrypicker.skeleton.axis_radii import typical_scatter
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.intervals import branch_terms, interval
from cherrypicker.traits.photo_diameters import with_photos
from cherrypicker.traits.table import BRANCH_COLUMNS, BranchColumn, ends_of

# Of the stretch at an axis's base that its direction and its parent's are taken over, and that its
# base diameter is: at least, and in radii of its first node (docs/lab/traits.md has the ablation)
DIRECTION_M = 0.15
LEAST_WINDOW_M, WINDOW_RADII = 0.08, 4.0
# What makes an axis's numbers weak (guesses)
_LOW_ARC_DEG, _FEW_POINTS = 150.0, 20


def axis_shapes(skeleton: Skeleton, axis_list: list[Axis]) -> dict[str, np.ndarray]:
    """Measure every axis; `branch_rows` tells what the numbers mean.

    Columns of ``branches.csv``, (n_axes,) float64, in the skeleton's unit and frame;
    `lateral_spacing_m` is NaN with fewer than two places of laterals. Beside them `base_residual`,
    the scatter of the points behind the base diameter, `base_error`, the standard error of a radius
    there, `base_photo_error`, that of a diameter by points and photos, and `stretch`, the length
    that the direction is taken over.
    """
    none = np.zeros(len(skeleton))
    arc, n_points, residual, error, gap, photo_error = (
        skeleton.fields.get(name, none)
        for name in ("arc_deg", "n_points", "residual", "radius_error", "gap", "photo_error")
    )
    radius, length = skeleton.radius, skeleton.edge_length
    lines = [Line(skeleton.points[axis.way]) for axis in axis_list]
    place = np.zeros(len(skeleton))  # of a node along its own axis
    for axis, line in zip(axis_list, lines, strict=True):
        place[axis.nodes] = line.along[-len(axis.nodes) :]
    feet = np.array([axis.attach for axis in axis_list if axis.attach >= 0], dtype=np.int64)
    is_foot = np.zeros(len(skeleton), dtype=bool)
    is_foot[feet] = True
    n_laterals = np.bincount([axis.parent + 1 for axis in axis_list], minlength=len(axis_list) + 1)
    rows = []
    for index, (axis, line) in enumerate(zip(axis_list, lines, strict=True)):
        nodes, total = axis.nodes, line.along[-1]
        skip = 0.0 if axis.attach < 0 else min(radius[axis.attach], 0.5 * total)
        direction = line.direction(skip, skip + DIRECTION_M)
        below = np.array([0.0, 0.0, 1.0])
        if axis.attach >= 0:
            # Through the place that it hangs on; where its parent ends, of what lies below
            parent, at = lines[axis.parent], place[axis.attach]
            is_end = at >= parent.along[-1] - NEAR
            start = at - (2 * DIRECTION_M if is_end else DIRECTION_M)
            below = parent.direction(start, at + DIRECTION_M)
        window = max(LEAST_WINDOW_M, WINDOW_RADII * radius[nodes[0]])
        at = place[nodes]
        base = (at >= skip - NEAR) & (at <= skip + window + NEAR)
        if not base.any():
            base[np.argmin(np.abs(at - (skip + (skip + window)) / 2))] = True
        laterals = at[is_foot[nodes]]
        rows.append(
            {
                "length_m": total,
                "chord_m": np.linalg.norm(line.points[-1] - line.points[0]),
                "base_diameter_m": 2.0 * np.median(radius[nodes][base]),
                "tip_diameter_m": 2.0 * radius[nodes[-1]],
                "insertion_angle_deg": np.degrees(np.arccos(np.clip(direction @ below, -1.0, 1.0))),
                "azimuth_deg": np.degrees(np.arctan2(direction[1], direction[0])) % 360.0,
                "base_height_m": line.points[0, 2],
                **_wood(line.along, radius[axis.wood]),
                "n_laterals": n_laterals[index + 1],
                "lateral_spacing_m": np.median(np.diff(laterals)) if len(laterals) > 1 else np.nan,
                "shoot_length_m": total - (laterals[-1] if len(laterals) else 0.0),
                "base_arc_deg": np.median(arc[nodes][base]),
                "base_n_points": np.median(n_points[nodes][base]),
                "gap_share": length[nodes] @ (gap[nodes] > 0) / max(length[nodes].sum(), 1e-12),
                "base_residual": np.median(residual[nodes][base]),
                "base_error": np.median(error[nodes][base]),
                "base_photo_error": np.median(photo_error[nodes][base]),
                "stretch": min(DIRECTION_M, total - skip),
            }
        )
    return {name: np.array([row[name] for row in rows], dtype=np.float64) for name in rows[0]}


def _wood(along: np.ndarray, radius: np.ndarray) -> dict[str, float]:
    """Mean diameter over the length, taper and volume, from the node that the axis hangs on."""
    step, thick, thin = np.diff(along), radius[:-1], radius[1:]
    taper = 0.0
    if along[-1] > 0:
        offset = along - along.mean()
        # Of what it is thinner than at its base, so that no rounding tapers an even axis
        taper = 2e3 * (offset @ (radius[0] - radius)) / (offset @ offset)
    return {
        "mean_diameter_m": step @ (thick + thin) / max(along[-1], 1e-12),
        "taper_mm_per_m": taper,
        "volume_m3": np.pi / 3 * (step @ (thick**2 + thick * thin + thin**2)),
    }


def branch_rows(
    skeleton: Skeleton,
    axis_list: list[Axis],
    foot_z: float,
    *,
    scale_error: float = 0.0,
    photo_check: Mapping | None = None,
) -> list[dict]:
    """Measure every axis: the rows of ``branches.csv``, keys as in `BRANCH_COLUMNS`.

    Lengths are in the skeleton's unit, an axis's from the node that it hangs on, so that lengths
    add up to the skeleton's. The insertion angle lies between the axis's first direction and its
    parent's at the junction; for the trunk it is its angle to the vertical. The azimuth runs from
    +x towards +y, 0 to 360 degrees. The trunk's parent is -1. `lateral_spacing_m` is the median
    distance along the axis of successive laterals (None with fewer than two), `shoot_length_m` the
    way from the last lateral to the tip, a candidate for the last year's shoot. `flags` holds words
    joined by spaces: ``low_arc``, ``few_points``, ``gap``. The 90 % intervals (`..._low_...`,
    `..._high_...`) are None on a skeleton that does not know how its points scatter.
    `photo_diameter_m` is the mean diameter of the axis's silhouettes in the photos, None where they
    show none; where any stands, all diameters, tapers and volumes are by points and photos
    (`cherrypicker.traits.photo_diameters`). `p_exists` is the probability by the photos that the
    axis is there, None without photos.

    The axes are those of `cherrypicker.skeleton.axes`, the trunk first. ``foot_z`` is the height of
    the stem's foot in the skeleton's frame, ``scale_error`` the relative standard error of the
    scan's scale, for the intervals, and ``photo_check`` the content of ``photo_check.json``.
    """
    check = photo_check or {}
    skeleton = with_photos(skeleton, axis_list, check.get("branches", ()), scale_error)
    found = axis_shapes(skeleton, axis_list)
    weak = {
        "low_arc": ("arc_deg" in skeleton.fields) & (found["base_arc_deg"] < _LOW_ARC_DEG),
        "few_points": ("n_points" in skeleton.fields) & (found["base_n_points"] < _FEW_POINTS),
        "gap": found["gap_share"] > 0,
    }
    found |= {
        "branch_id": np.arange(len(axis_list)),
        "parent_id": np.array([axis.parent for axis in axis_list]),
        "order": np.array([axis.order for axis in axis_list]),
        "base_height_m": found["base_height_m"] - foot_z,
        "flags": np.array([" ".join(compress(weak, each)) for each in zip(*weak.values())]),
    }
    found |= {name: np.full(len(axis_list), np.nan) for name in BRANCH_COLUMNS.keys() - found}
    typical = typical_scatter(skeleton)
    if typical is not None:
        for name, terms in branch_terms(found, typical, scale_error).items():
            most = 180.0 if name.endswith("_deg") else np.inf
            below, above = ends_of(name)
            found[below], found[above] = np.minimum(interval(found[name], terms), most)
    low, high = (found[f"base_diameter_{end}_m"] for end in ("low", "high"))
    for each in check.get("branches", ()):
        row = each["branch_id"]
        found["photo_diameter_m"][row] = each["diameter"]
        found["photo_diameter_se_m"][row] = each["diameter_se"]
        terms = {"fit": found["base_photo_error"][row]}
        low[row], high[row] = interval(found["base_diameter_m"][row], terms)
    for each in check.get("axes", ()):
        found["p_exists"][each["branch_id"]] = each["p_exists"]
    columns = {name: found[name].tolist() for name in BRANCH_COLUMNS}
    for name, cells in columns.items():
        if BRANCH_COLUMNS[name].kind == "whole":
            columns[name] = [round(cell) for cell in cells]
        elif BRANCH_COLUMNS[name].kind == "maybe":
            columns[name] = [None if np.isnan(cell) else cell for cell in cells]
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def branches_csv(rows: list[dict], columns: Mapping[str, BranchColumn] = BRANCH_COLUMNS) -> str:
    """Return rows as CSV text with a header, the cells as rough as the columns say."""
    cells = ({name: each.write(row[name]) for name, each in columns.items()} for row in rows)
    return csv_text(cells, columns)


def read_branches(
    path: str | os.PathLike, columns: Mapping[str, BranchColumn] = BRANCH_COLUMNS
) -> list[dict]:
    """Read ``branches.csv``, or with `LIMB_COLUMNS` ``limbs.csv``: its columns, a row an axis.

    Cells are as `cherrypicker.traits.table.BranchColumn` reads them. A `StageError` where the file
    is missing or a cell is no number.
    """
    rows: list[dict] = []
    try:
        with open(path, encoding="utf-8", newline="") as stream:
            for row in csv.DictReader(stream):
                known = ((name, each) for name, each in columns.items() if name in row)
                rows.append({name: each.read(row[name]) for name, each in known})
    except (OSError, ValueError, TypeError, csv.Error) as error:
        place = "" if isinstance(error, OSError) else f", after {len(rows)} rows"
        cause = f"not a readable table of {Path(path).stem} ({error}{place})"
        raise StageError(cause, file=path) from error
    return rows
