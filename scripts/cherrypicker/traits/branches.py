"""One row an axis: length, chord, diameters, insertion angle, azimuth, height of its base.

An axis leaves its parent inside the parent's wood and a contracted skeleton bends there, so
directions and base diameters are taken beyond the parent's surface.
"""

import csv
import io

import numba
import numpy as np

from cherrypicker.skeleton import axis_polyline
from cherrypicker.skeleton.strands import arc_length
from cherrypicker.traits.branch_intervals import (
    angle_interval,
    diameter_interval,
    typical_scatter,
)

__all__ = ["AXIS_COLUMNS", "BRANCH_COLUMNS", "branch_rows", "branches_csv", "totals_by_order"]

#: What every axis has, a number each; the others may be empty.
AXIS_COLUMNS = (
    "branch_id",
    "parent_id",
    "order",
    "length_m",
    "chord_m",
    "base_diameter_m",
    "tip_diameter_m",
    "insertion_angle_deg",
    "azimuth_deg",
    "base_height_m",
)
BRANCH_COLUMNS = (
    *AXIS_COLUMNS,
    "mean_diameter_m",
    "taper_mm_per_m",
    "volume_m3",
    "n_laterals",
    "lateral_spacing_m",
    "shoot_length_m",
    "base_arc_deg",
    "base_n_points",
    "gap_share",
    "flags",
    "base_diameter_low_m",
    "base_diameter_high_m",
    "insertion_angle_low_deg",
    "insertion_angle_high_deg",
)
_LOW_ARC_DEG, _FEW_POINTS, _MUCH_GAP = 150.0, 20, 0.2
_LEAST_WINDOW_M = 0.08
_TIP_WINDOW_M = 0.03


def branch_rows(skeleton, axis_list, foot_z, *, scale_error=0.0):
    """Measure every axis.

    Parameters
    ----------
    skeleton : Skeleton
    axis_list : list of Axis
        From `cherrypicker.skeleton.axes`; the trunk first.
    foot_z : float
        Height of the stem's foot in the skeleton's frame.
    scale_error : float, default 0
        Relative standard error of the scan's scale, for the intervals.

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
        skeleton that does not know how its points scatter.
    """
    tree = _Measured(skeleton, axis_list)
    return [_row(tree, index, foot_z, scale_error) for index in range(len(axis_list))]


def branches_csv(rows):
    """Return rows as CSV text with a header; lengths to 0.01 mm, angles to 0.01 degrees."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(BRANCH_COLUMNS)
    for row in rows:
        writer.writerow([_cell(name, row[name]) for name in BRANCH_COLUMNS])
    return stream.getvalue()


def _cell(name, value):
    """Text of a cell; empty where there is no such number."""
    if value is None:
        return ""
    if isinstance(value, int | str):
        return value
    decimals = 2 if name.endswith(("_deg", "_per_m")) else 8 if name.endswith("_m3") else 5
    return f"{value:.{decimals}f}"


def totals_by_order(rows):
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
    for row in rows:
        total = totals.setdefault(row["order"], {"n": 0, "length": 0.0, "volume": 0.0, "sum": 0.0})
        total["n"] += 1
        total["length"] += row["length_m"]
        total["volume"] += row["volume_m3"]
        total["sum"] += row["mean_diameter_m"] * row["length_m"]
    for total in totals.values():
        total["mean_diameter"] = total.pop("sum") / max(total["length"], 1e-12)
    return dict(sorted(totals.items()))


class _Measured:
    """A skeleton with what every axis asks for, computed once."""

    def __init__(self, skeleton, axis_list):
        self.axes, self.points, self.radius = axis_list, skeleton.points, skeleton.radius
        self.scatter = typical_scatter(skeleton)
        none = np.zeros(len(skeleton))
        self.length, self.fields = skeleton.edge_length, skeleton.fields
        self.arc = np.asarray(skeleton.fields.get("arc_deg", none), dtype=np.float64)
        self.count = np.asarray(skeleton.fields.get("n_points", none), dtype=np.float64)
        self.residual = np.asarray(skeleton.fields.get("residual", none), dtype=np.float64)
        self.gap = np.asarray(skeleton.fields.get("gap", none))
        self.along = [arc_length(skeleton.points[axis_polyline(axis)]) for axis in axis_list]
        self.feet = [[] for _ in axis_list]
        for axis in axis_list:
            if axis.parent >= 0:
                self.feet[axis.parent].append(axis.attach)


def _row(tree, index, foot_z, scale_error):
    axis, along = tree.axes[index], tree.along[index]
    line = axis_polyline(axis)
    points = tree.points[line]
    own = along if axis.attach < 0 else along[1:]  # of the axis's own nodes
    radius = tree.radius[axis.nodes]
    skip = 0.0 if axis.attach < 0 else min(tree.radius[axis.attach], 0.5 * along[-1])
    window = max(_LEAST_WINDOW_M, 4.0 * float(radius[0]))
    direction = _direction(points, along, skip, skip + window)
    if axis.attach < 0:
        reference = np.array([0.0, 0.0, 1.0])
    else:
        reference = _parent_direction(tree, axis.parent, axis.attach, window)
    cosine = float(np.clip(direction @ reference, -1.0, 1.0))
    diameter = 2.0 * _median_between(radius, own, skip, skip + window)
    angle = float(np.degrees(np.arccos(cosine)))
    quality = _quality(tree, axis, own, skip, skip + window)
    scatter = _median_between(tree.residual[axis.nodes], own, skip, skip + window)
    return {
        "branch_id": index,
        "parent_id": int(axis.parent),
        "order": int(axis.order),
        "length_m": float(along[-1]),
        "chord_m": float(np.linalg.norm(points[-1] - points[0])),
        "base_diameter_m": diameter,
        "tip_diameter_m": 2.0 * _median_between(radius, own, own[-1] - _TIP_WINDOW_M, own[-1]),
        "insertion_angle_deg": angle,
        "azimuth_deg": float(np.degrees(np.arctan2(direction[1], direction[0])) % 360.0),
        "base_height_m": float(points[0, 2] - foot_z),
        **_wood(axis, own, radius, along),
        **_laterals(tree.feet[index], along, line),
        **quality,
        **_intervals(
            diameter,
            angle,
            scatter or tree.scatter,
            quality["base_n_points"],
            min(window, along[-1] - skip),
            scale_error,
        ),
    }


def _intervals(diameter, angle, scatter, n_points, stretch, scale_error):
    """The columns of the 90 % intervals, None without a scatter."""
    ends = [None] * 4
    if scatter:
        ends = [
            *diameter_interval(diameter, scatter, scale_error),
            *angle_interval(angle, scatter, n_points, stretch),
        ]
    return dict(zip(BRANCH_COLUMNS[-4:], ends, strict=True))


def _wood(axis, own, radius, along):
    """Mean diameter over the length, taper and volume of an axis, from its nodes' radii."""
    at, r = own, radius
    if axis.attach >= 0:  # from the node that it hangs on, with its own first radius
        at, r = along, np.concatenate([radius[:1], radius])
    step, thick, thin = np.diff(at), r[:-1], r[1:]
    length = max(float(step.sum()), 1e-12)
    is_sloped = len(at) > 1 and np.ptp(at) > 0
    return {
        "mean_diameter_m": float((step * (thick + thin)).sum() / length),
        "taper_mm_per_m": -2e3 * float(_slope(at, r[:, None])[0]) if is_sloped else 0.0,
        "volume_m3": float((np.pi / 3 * step * (thick**2 + thick * thin + thin**2)).sum()),
    }


def _laterals(feet, along, line):
    """Number and spacing of the laterals of an axis, and the way from the last to the tip."""
    at = np.sort(along[np.flatnonzero(np.isin(line, feet))])  # a whorl counts as one place
    return {
        "n_laterals": len(feet),
        "lateral_spacing_m": float(np.median(np.diff(at))) if len(at) > 1 else None,
        "shoot_length_m": float(along[-1] - (at[-1] if len(at) else 0.0)),
    }


def _quality(tree, axis, own, low, high):
    """What the base diameter rests on, and the share of the axis that bridges missing data."""
    arc = _median_between(tree.arc[axis.nodes], own, low, high)
    count = _median_between(tree.count[axis.nodes], own, low, high)
    length = tree.length[axis.nodes]
    share = float(length[tree.gap[axis.nodes] > 0].sum()) / max(float(length.sum()), 1e-12)
    words = []
    if "arc_deg" in tree.fields and arc < _LOW_ARC_DEG:
        words.append("low_arc")
    if "n_points" in tree.fields and count < _FEW_POINTS:
        words.append("few_points")
    if share > _MUCH_GAP:
        words.append("gap")
    return {
        "base_arc_deg": float(arc),
        "base_n_points": int(round(count)),
        "gap_share": share,
        "flags": " ".join(words),
    }


@numba.njit(cache=True)
def _median_between(values, along, low, high):
    """Median of the values whose position lies in a stretch; the nearest one's where none does."""
    inside, n, nearest = np.empty(len(values)), 0, 0
    middle = (low + high) / 2
    for row in range(len(values)):
        if low - 1e-9 <= along[row] <= high + 1e-9:
            inside[n] = values[row]
            n += 1
        if abs(along[row] - middle) < abs(along[nearest] - middle):
            nearest = row
    return np.median(inside[:n]) if n else values[nearest]


@numba.njit(cache=True)
def _slope(at, values):
    """Slope of the line through the values (n, d) over their positions (n,), (d,) float64."""
    offset = at - at.mean()
    slope = np.zeros(values.shape[1])
    for column in range(values.shape[1]):
        slope[column] = (offset * values[:, column]).sum() / (offset * offset).sum()
    return slope


@numba.njit(cache=True)
def _direction(points, along, low, high):
    """Unit direction of a polyline over a stretch: a line fitted to even samples of it."""
    if len(points) < 2 or along[-1] <= 0:
        return np.array([0.0, 0.0, 1.0])
    low, high = max(low, 0.0), min(high, along[-1])
    if high - low < 1e-9:
        low, high = 0.0, along[-1]
    at = low + (high - low) * np.arange(12) / 11
    samples = np.empty((12, 3))
    for column in range(3):
        samples[:, column] = np.interp(at, along, points[:, column])
    slope = _slope(at, samples)
    norm = np.sqrt((slope * slope).sum())
    if norm < 1e-9:
        chord = samples[-1] - samples[0]
        return chord / max(np.sqrt((chord * chord).sum()), 1e-12)
    return slope / norm


def _parent_direction(tree, parent, attach, window):
    """Direction of the parent axis through a junction, over `window` on either side of it."""
    line, along = axis_polyline(tree.axes[parent]), tree.along[parent]
    at = along[np.flatnonzero(line == attach)[0]]
    low, high = at - window, at + window
    if at >= along[-1] - 1e-9:  # the parent ends here: only what lies below counts
        low = at - 2 * window
    return _direction(tree.points[line], along, low, high)
