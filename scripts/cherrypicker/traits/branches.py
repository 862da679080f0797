"""One row an axis: length, chord, diameters, insertion angle, azimuth, height of its base.

An axis leaves its parent inside the parent's wood and a contracted skeleton bends there, so
directions and base diameters are taken beyond the parent's surface.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.skeleton.axes import Axis
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.branch_shapes import axis_shapes
from cherrypicker.traits.intervals import Z90, branch_terms, interval, typical_scatter
from cherrypicker.traits.table import BRANCH_COLUMNS, BranchColumn

# What a diameter scales, and its power there
_SCALED = {
    "base_diameter_m": 1,
    "tip_diameter_m": 1,
    "mean_diameter_m": 1,
    "taper_mm_per_m": 1,
    "volume_m3": 2,
}
# What makes an axis's numbers weak (guesses)
_LOW_ARC_DEG, _FEW_POINTS, _MUCH_GAP = 150.0, 20, 0.2


def branch_rows(
    skeleton: Skeleton,
    axis_list: list[Axis],
    foot_z: float,
    *,
    scale_error: float = 0.0,
    photo_check: Mapping | None = None,
) -> list[dict]:
    """Measure every axis.

    Parameters
    ----------
    axis_list : list of Axis
        From `cherrypicker.skeleton.axes`; the trunk first.
    foot_z : float
        Height of the stem's foot in the skeleton's frame.
    scale_error : float, default 0
        Relative standard error of the scan's scale, for the intervals.
    photo_check : dict, optional
        ``photo_check.json`` of a scan from photos.

    Returns
    -------
    list of dict
        Keys as in `BRANCH_COLUMNS`. Lengths in the skeleton's unit, an axis's from the node that
        it hangs on, so that lengths add up to the skeleton's. The insertion angle lies between the
        axis's first direction and its parent's at the junction; for the trunk it is its angle to
        the vertical. The azimuth runs from +x towards +y, 0 to 360 degrees. The trunk's parent is
        -1. `lateral_spacing_m` is the median distance along the axis of successive laterals (None
        with fewer than two), `shoot_length_m` the way from the last lateral to the tip, a candidate
        for the last year's shoot. `flags` holds words joined by spaces: ``low_arc``,
        ``few_points``, ``gap``. The 90 % intervals (`..._low_...`, `..._high_...`) are None on a
        skeleton that does not know how its points scatter. `photo_diameter_m` is the mean diameter
        of the axis's silhouettes in the photos, None where the points tell it more surely; where
        it stands, it scales the axis's diameters, taper and volume. `p_exists` is the probability
        by the photos that the axis is there, None without photos.
    """
    found, check = axis_shapes(skeleton, axis_list), photo_check or {}
    weak = {
        "low_arc": ("arc_deg" in skeleton.fields) & (found["base_arc_deg"] < _LOW_ARC_DEG),
        "few_points": ("n_points" in skeleton.fields) & (found["base_n_points"] < _FEW_POINTS),
        "gap": found["gap_share"] > _MUCH_GAP,
    }
    found |= {
        "branch_id": np.arange(len(axis_list)),
        "parent_id": np.array([axis.parent for axis in axis_list]),
        "order": np.array([axis.order for axis in axis_list]),
        "base_height_m": found["base_height_m"] - foot_z,
    }
    unknown = [name for name in BRANCH_COLUMNS if name not in found and name != "flags"]
    found |= {name: np.full(len(axis_list), np.nan) for name in unknown}
    typical = typical_scatter(skeleton)
    if typical is not None:
        for name, terms in branch_terms(found, typical, scale_error).items():
            stem, unit = name.rsplit("_", 1)
            low, high = interval(found[name], terms)
            found[f"{stem}_low_{unit}"] = low
            found[f"{stem}_high_{unit}"] = np.minimum(high, 180.0) if unit == "deg" else high
    for each in check.get("branches", ()):
        _use_photos(found, each, scale_error)
    for each in check.get("axes", ()):
        found["p_exists"][each["branch_id"]] = each["p_exists"]
    columns = {name: found[name].tolist() for name in BRANCH_COLUMNS if name != "flags"}
    for name, cells in columns.items():
        if BRANCH_COLUMNS[name].kind == "whole":
            columns[name] = [round(cell) for cell in cells]
        elif BRANCH_COLUMNS[name].kind == "maybe":
            columns[name] = [None if np.isnan(cell) else cell for cell in cells]
    columns["flags"] = [
        " ".join(word for word, is_so in weak.items() if is_so[row])
        for row in range(len(axis_list))
    ]
    return [{name: columns[name][row] for name in BRANCH_COLUMNS} for row in range(len(axis_list))]


def _use_photos(found: dict[str, np.ndarray], each: Mapping, scale_error: float) -> None:
    """Take an axis's mean diameter by the photos where it is surer than the points'.

    What the photos say of an axis's tubes at the places that they measured holds for all of it, but
    the rest of its length has the points' error still. Where that makes a smaller error than the
    points', the axis's diameters are scaled, and the interval of its base follows.
    """
    row, factor = each["branch_id"], each["diameter"] / each["tube_diameter"]
    low, high = found["base_diameter_low_m"], found["base_diameter_high_m"]
    base = factor * found["base_diameter_m"][row]
    if not np.isnan(high[row]):
        by_points = (high[row] - found["base_diameter_m"][row]) / Z90
        rest = max(1.0 - each["length"] / found["length_m"][row], 0.0)
        by_photos = each["diameter_se"] / each["diameter"] * base
        error = np.linalg.norm([rest * by_points, by_photos, scale_error * base])
        if error >= by_points:
            return
        low[row], high[row] = max(base - Z90 * error, 0.0), base + Z90 * error
    found["photo_diameter_m"][row] = each["diameter"]
    found["photo_diameter_se_m"][row] = each["diameter_se"]
    for name, power in _SCALED.items():
        found[name][row] *= factor**power


def totals_by_order(rows: list[dict]) -> dict[int, dict]:
    """Number, length, volume and mean diameter of the axes of each order.

    Parameters
    ----------
    rows : list of dict
        From `branch_rows`.

    Returns
    -------
    dict of int to dict
        Order to ``n``, ``length``, ``volume`` and ``mean_diameter`` (weighted by length).
    """
    totals = {}
    for order in sorted({row["order"] for row in rows}):
        own = [row for row in rows if row["order"] == order]
        length = sum(row["length_m"] for row in own)
        totals[order] = {
            "n": len(own),
            "length": length,
            "volume": sum(row["volume_m3"] for row in own),
            "mean_diameter": sum(row["mean_diameter_m"] * row["length_m"] for row in own)
            / max(length, 1e-12),
        }
    return totals


def branches_csv(rows: list[dict], columns: Mapping[str, BranchColumn] = BRANCH_COLUMNS) -> str:
    """Return rows as CSV text with a header, the cells as rough as the columns say."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([column.write(row[name]) for name, column in columns.items()])
    return stream.getvalue()


def read_branches(
    path: str | os.PathLike, columns: Mapping[str, BranchColumn] = BRANCH_COLUMNS
) -> list[dict]:
    """Read ``branches.csv``, or with `LIMB_COLUMNS` ``limbs.csv``.

    Returns
    -------
    list of dict
        A row an axis, cells as `cherrypicker.traits.table.BranchColumn` reads them.

    Raises
    ------
    StageError
        If the file is missing or a cell is no number.
    """
    try:
        with open(path, encoding="utf-8", newline="") as stream:
            return [
                {name: columns[name].read(text) for name, text in row.items()}
                for row in csv.DictReader(stream)
            ]
    except (OSError, ValueError, TypeError, KeyError, csv.Error) as error:
        cause = f"not a readable table of {Path(path).stem} ({error})"
        raise StageError(cause, file=path) from error
