"""One row an axis: length, chord, diameters, insertion angle, azimuth, height of its base.

An axis leaves its parent inside the parent's wood and a contracted skeleton bends there, so
directions and base diameters are taken beyond the parent's surface.
"""

import csv
import io

import numpy as np

from cherrypicker.skeleton import axis_polyline

__all__ = ["BRANCH_COLUMNS", "branch_rows", "branches_csv"]

BRANCH_COLUMNS = (
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
_LEAST_WINDOW_M = 0.08
_TIP_WINDOW_M = 0.03


def branch_rows(skeleton, axis_list, foot_z):
    """Measure every axis.

    Parameters
    ----------
    skeleton : Skeleton
    axis_list : list of Axis
        From `cherrypicker.skeleton.axes`; the trunk first.
    foot_z : float
        Height of the stem's foot in the skeleton's frame.

    Returns
    -------
    list of dict
        Keys as in `BRANCH_COLUMNS`. Lengths in the skeleton's unit, an axis's from the node that
        it hangs on, so that lengths add up to the skeleton's. The insertion angle lies between the
        axis's first direction and its parent's at the junction; for the trunk it is its angle to
        the vertical. The azimuth runs from +x towards +y, 0 to 360 degrees. The trunk's parent is
        -1.
    """
    return [_row(skeleton, axis_list, index, foot_z) for index in range(len(axis_list))]


def branches_csv(rows):
    """Return rows as CSV text with a header; lengths to 0.01 mm, angles to 0.01 degrees."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(BRANCH_COLUMNS)
    for row in rows:
        writer.writerow(
            [
                row[name] if isinstance(row[name], int) else f"{row[name]:.{_decimals(name)}f}"
                for name in BRANCH_COLUMNS
            ]
        )
    return stream.getvalue()


def _decimals(name):
    return 2 if name.endswith("_deg") else 5


def _row(skeleton, axis_list, index, foot_z):
    axis = axis_list[index]
    line = axis_polyline(axis)
    points = skeleton.points[line]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    own = along if axis.attach < 0 else along[1:]  # of the axis's own nodes
    radius = skeleton.radius[axis.nodes]
    skip = 0.0 if axis.attach < 0 else min(skeleton.radius[axis.attach], 0.5 * along[-1])
    window = max(_LEAST_WINDOW_M, 4.0 * float(radius[0]))
    direction = _direction(points, along, skip, skip + window)
    if axis.attach < 0:
        reference = np.array([0.0, 0.0, 1.0])
    else:
        reference = _parent_direction(skeleton, axis_list[axis.parent], axis.attach, window)
    cosine = float(np.clip(direction @ reference, -1.0, 1.0))
    return {
        "branch_id": index,
        "parent_id": int(axis.parent),
        "order": int(axis.order),
        "length_m": float(along[-1]),
        "chord_m": float(np.linalg.norm(points[-1] - points[0])),
        "base_diameter_m": 2.0 * _median_between(radius, own, skip, skip + window),
        "tip_diameter_m": 2.0 * _median_between(radius, own, own[-1] - _TIP_WINDOW_M, own[-1]),
        "insertion_angle_deg": float(np.degrees(np.arccos(cosine))),
        "azimuth_deg": float(np.degrees(np.arctan2(direction[1], direction[0])) % 360.0),
        "base_height_m": float(points[0, 2] - foot_z),
    }


def _median_between(values, along, low, high):
    """Median of the values whose position lies in a stretch; the nearest one's where none does."""
    inside = (along >= low - 1e-9) & (along <= high + 1e-9)
    if not inside.any():
        inside = np.arange(len(values)) == np.argmin(np.abs(along - (low + high) / 2))
    return float(np.median(values[inside]))


def _direction(points, along, low, high):
    """Unit direction of a polyline over a stretch: a line fitted to even samples of it."""
    if len(points) < 2 or along[-1] <= 0:
        return np.array([0.0, 0.0, 1.0])
    low, high = max(low, 0.0), min(high, along[-1])
    if high - low < 1e-9:
        low, high = 0.0, along[-1]
    at = np.linspace(low, high, 12)
    samples = np.array([np.interp(at, along, axis) for axis in points.T]).T
    slope = np.polyfit(at, samples, 1)[0]
    norm = np.linalg.norm(slope)
    chord = samples[-1] - samples[0]
    if norm < 1e-9:
        return chord / max(np.linalg.norm(chord), 1e-12)
    return slope / norm


def _parent_direction(skeleton, parent, attach, window):
    """Direction of the parent axis through a junction, over `window` on either side of it."""
    line = axis_polyline(parent)
    points = skeleton.points[line]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = along[np.flatnonzero(line == attach)[0]]
    low, high = at - window, at + window
    if at >= along[-1] - 1e-9:  # the parent ends here: only what lies below counts
        low = at - 2 * window
    return _direction(points, along, low, high)
