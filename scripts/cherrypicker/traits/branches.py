"""One row an axis: length, chord, diameters, insertion angle, azimuth, height of its base.

An axis leaves its parent inside the parent's wood and a contracted skeleton bends there, so
directions and base diameters are taken beyond the parent's surface.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.skeleton.axes import Axis
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.branch_shapes import axis_shapes
from cherrypicker.traits.intervals import Z90, branch_terms, interval, typical_scatter
from cherrypicker.traits.table import BRANCH_COLUMNS, LIMB_COLUMNS, BranchColumn

_INTERVALS = tuple(name for name in BRANCH_COLUMNS if "_low_" in name or "_high_" in name)
_PHOTO = ("photo_diameter_m", "photo_diameter_se_m")
# What a diameter scales, and its power there
_SCALED = {"base_diameter": 1, "tip_diameter": 1, "mean_diameter": 1, "taper": 1, "volume": 2}
# What makes an axis's numbers weak (guesses)
_LOW_ARC_DEG, _FEW_POINTS, _MUCH_GAP = 150.0, 20, 0.2


def branch_rows(
    skeleton: Skeleton,
    axis_list: list[Axis],
    foot_z: float,
    *,
    scale_error: float = 0.0,
    photo_check: Mapping | None = None,
) -> list:
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
    shape = axis_shapes(skeleton, axis_list)
    count = np.rint(shape["base_n_points"]).astype(np.int64)
    intervals = _intervals(shape, typical_scatter(skeleton), scale_error)
    by_photos = _use_photos(shape, intervals, photo_check, scale_error)
    columns = {
        "branch_id": range(len(axis_list)),
        "parent_id": [int(axis.parent) for axis in axis_list],
        "order": [int(axis.order) for axis in axis_list],
        "length_m": shape["length"],
        "chord_m": shape["chord"],
        "base_diameter_m": shape["base_diameter"],
        "tip_diameter_m": shape["tip_diameter"],
        "insertion_angle_deg": shape["insertion_angle"],
        "azimuth_deg": shape["azimuth"],
        "base_height_m": shape["base_z"] - foot_z,
        "mean_diameter_m": shape["mean_diameter"],
        "taper_mm_per_m": shape["taper"],
        "volume_m3": shape["volume"],
        "n_laterals": shape["n_laterals"].astype(np.int64),
        "lateral_spacing_m": _or_none(shape["lateral_spacing"]),
        "shoot_length_m": shape["shoot_length"],
        "base_arc_deg": shape["base_arc"],
        "base_n_points": count,
        "gap_share": shape["gap_share"],
        "flags": _flags(skeleton, shape),
        **intervals,
        **by_photos,
        "p_exists": _existence(len(axis_list), photo_check),
    }
    listed = [c.tolist() if isinstance(c, np.ndarray) else c for c in columns.values()]
    return [dict(zip(columns, row, strict=True)) for row in zip(*listed, strict=True)]


def _or_none(values: np.ndarray) -> list:
    return [None if np.isnan(value) else value for value in values.tolist()]


def _flags(skeleton: Skeleton, shape: dict) -> list[str]:
    """What is weak about each axis, words joined by spaces."""
    weak = {
        "low_arc": ("arc_deg" in skeleton.fields) & (shape["base_arc"] < _LOW_ARC_DEG),
        "few_points": ("n_points" in skeleton.fields) & (shape["base_n_points"] < _FEW_POINTS),
        "gap": shape["gap_share"] > _MUCH_GAP,
    }
    rows = zip(*(column.tolist() for column in weak.values()), strict=True)
    return [" ".join(word for word, is_so in zip(weak, row, strict=True) if is_so) for row in rows]


def _intervals(shape: dict, typical: float | None, scale_error: float) -> dict:
    """The columns of the 90 % intervals, None without a scatter."""
    if typical is None:
        return {name: [None] * len(shape["length"]) for name in _INTERVALS}
    terms = branch_terms(shape, typical, scale_error)
    low, high = interval(shape["insertion_angle"], terms["insertion_angle_deg"])
    ends = *interval(shape["base_diameter"], terms["base_diameter_m"]), low, np.minimum(high, 180.0)
    return dict(zip(_INTERVALS, ends, strict=True))


def _use_photos(
    shape: dict, intervals: dict, photo_check: Mapping | None, scale_error: float
) -> dict[str, list]:
    """Mean diameters by the photos and their errors, None where the points are surer.

    What the photos say of an axis's tubes at the places that they measured holds for all of it, but
    the rest of its length has the points' error still. Where that makes a smaller error than the
    points', the axis's diameters are scaled, and the interval of its base follows.
    """
    low, high = intervals["base_diameter_low_m"], intervals["base_diameter_high_m"]
    found: dict[str, list] = {name: [None] * len(high) for name in _PHOTO}
    for each in (photo_check or {}).get("branches", ()):
        row, factor = each["branch_id"], each["diameter"] / each["tube_diameter"]
        base = factor * shape["base_diameter"][row]
        if high[row] is not None:
            by_points = (high[row] - shape["base_diameter"][row]) / Z90
            rest = max(1.0 - each["length"] / shape["length"][row], 0.0)
            shares = each["diameter_se"] / each["diameter"], scale_error
            error = np.linalg.norm([rest * by_points, *(share * base for share in shares)])
            if error >= by_points:
                continue
            low[row], high[row] = max(base - Z90 * error, 0.0), base + Z90 * error
        found["photo_diameter_m"][row] = each["diameter"]
        found["photo_diameter_se_m"][row] = each["diameter_se"]
        for name, power in _SCALED.items():
            shape[name][row] *= factor**power
    return found


def _existence(n_axes: int, photo_check: Mapping | None) -> list[float | None]:
    """How probable each axis is by the photos, None where nobody was asked."""
    told = {each["branch_id"]: each["p_exists"] for each in (photo_check or {}).get("axes", ())}
    return [told.get(row) for row in range(n_axes)]


def branches_csv(rows: list[dict], columns: Mapping[str, BranchColumn] = BRANCH_COLUMNS) -> str:
    """Return rows as CSV text with a header, the cells as rough as the columns say."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_cell(column, row[name]) for name, column in columns.items()])
    return stream.getvalue()


def _cell(column: BranchColumn, value: float | str | None) -> int | str:
    """Text of a cell; empty where there is no such number."""
    if value is None:
        return ""
    if isinstance(value, int | str):
        return value
    return f"{value:.{column.decimals_in_file}f}"


def read_branches(path: str | os.PathLike) -> list:
    """Read ``branches.csv``.

    Returns
    -------
    list of dict
        A row an axis, cells as `cherrypicker.traits.table.BranchColumn` reads them.

    Raises
    ------
    StageError
        If the file is missing or a cell is no number.
    """
    return _read_rows(path, BRANCH_COLUMNS, "branches")


def read_limb_rows(path: str | os.PathLike) -> list:
    """Read ``limbs.csv`` as `read_branches` reads ``branches.csv``: a row a limb."""
    return _read_rows(path, LIMB_COLUMNS, "limbs")


def _read_rows(path: str | os.PathLike, columns: Mapping[str, BranchColumn], what: str) -> list:
    try:
        with open(path, encoding="utf-8", newline="") as stream:
            return [
                {name: columns[name].read(text) for name, text in row.items()}
                for row in csv.DictReader(stream)
            ]
    except (OSError, ValueError, TypeError, KeyError, csv.Error) as error:
        raise StageError(f"not a readable table of {what} ({error})", file=path) from error


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
    totals: dict[int, dict] = {}
    for row in rows:
        total = totals.setdefault(row["order"], {"n": 0, "length": 0.0, "volume": 0.0, "sum": 0.0})
        total["n"] += 1
        total["length"] += row["length_m"]
        total["volume"] += row["volume_m3"]
        total["sum"] += row["mean_diameter_m"] * row["length_m"]
    for total in totals.values():
        total["mean_diameter"] = total.pop("sum") / max(total["length"], 1e-12)
    return dict(sorted(totals.items()))
