"""Shapes of all axes of a skeleton in one compiled pass: lengths, directions, radii, laterals."""

from __future__ import annotations

import numba
import numpy as np

from cherrypicker.geometry.ordering import median
from cherrypicker.skeleton.axes import Axis
from cherrypicker.skeleton.model import Skeleton

__all__ = ["SHAPE_COLUMNS", "axis_shapes"]

#: Columns of `axis_shapes`; lengths in the skeleton's unit, angles in degrees.
SHAPE_COLUMNS = (
    "length",
    "chord",
    "base_diameter",
    "tip_diameter",
    "insertion_angle",
    "azimuth",
    "base_z",
    "mean_diameter",
    "taper",
    "volume",
    "n_laterals",
    "lateral_spacing",
    "shoot_length",
    "base_arc",
    "base_n_points",
    "gap_share",
    "base_residual",
    "stretch",
)
LEAST_WINDOW_M = 0.08
TIP_WINDOW_M = 0.03
N_SAMPLES = 12  # of a stretch whose direction is taken


def axis_shapes(skeleton: Skeleton, axis_list: list[Axis]) -> dict:
    """Measure every axis; `cherrypicker.traits.branch_rows` tells what the numbers mean.

    Parameters
    ----------
    skeleton : Skeleton
    axis_list : list of Axis

    Returns
    -------
    dict of str to ndarray of shape (n_axes,), float64
        By `SHAPE_COLUMNS`. `lateral_spacing` is NaN with fewer than two places of laterals,
        `base_residual` the scatter of the points behind the base diameter, `stretch` the length
        that the direction is taken over.
    """
    none = np.zeros(len(skeleton))
    fields = [
        np.asarray(skeleton.fields.get(name, none), dtype=np.float64)
        for name in ("arc_deg", "n_points", "residual", "gap")
    ]
    nodes = np.concatenate([axis.nodes for axis in axis_list]).astype(np.int64)
    first = np.cumsum([0, *(len(axis.nodes) for axis in axis_list)])
    attach = np.array([axis.attach for axis in axis_list], dtype=np.int64)
    parent = np.array([axis.parent for axis in axis_list], dtype=np.int64)
    points = np.ascontiguousarray(skeleton.points, dtype=np.float64)
    radius = np.ascontiguousarray(skeleton.radius, dtype=np.float64)
    length = np.ascontiguousarray(skeleton.edge_length, dtype=np.float64)
    lines = _lines(points, nodes, first, attach)
    arrays = *fields, nodes, first, attach, parent, *lines
    table = _shapes(points, radius, length, *arrays)  # type: ignore[call-arg]
    return dict(zip(SHAPE_COLUMNS, table.T, strict=True))


@numba.njit(cache=True)
def _lines(
    points: np.ndarray, nodes: np.ndarray, first: np.ndarray, attach: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Polylines from the nodes that axes hang on: their nodes, arc lengths and starts."""
    n_axes = len(attach)
    line, start = np.empty(len(nodes) + n_axes, dtype=np.int64), np.empty(n_axes + 1, np.int64)
    along, filled = np.zeros(len(line)), 0
    for axis in range(n_axes):
        start[axis] = filled
        if attach[axis] >= 0:
            line[filled] = attach[axis]
            filled += 1
        for at in range(first[axis], first[axis + 1]):
            line[filled] = nodes[at]
            filled += 1
        for at in range(start[axis] + 1, filled):
            along[at] = along[at - 1] + _apart(points, line[at], line[at - 1])
    start[n_axes] = filled
    return line[:filled], along[:filled], start


@numba.njit(cache=True)
def _apart(points: np.ndarray, a: int, b: int) -> float:
    """Distance of two points."""
    x, y, z = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
    return np.sqrt(x * x + y * y + z * z)


@numba.njit(cache=True)
def _shapes(
    points: np.ndarray,
    radius: np.ndarray,
    length: np.ndarray,
    arc: np.ndarray,
    count: np.ndarray,
    residual: np.ndarray,
    gap: np.ndarray,
    nodes: np.ndarray,
    first: np.ndarray,
    attach: np.ndarray,
    parent: np.ndarray,
    line: np.ndarray,
    along: np.ndarray,
    start: np.ndarray,
) -> np.ndarray:
    """The table of `axis_shapes`, (n_axes, n_columns)."""
    n_axes = len(attach)
    table = np.empty((n_axes, 18))
    n_laterals, is_foot = np.zeros(n_axes), np.zeros(len(points), dtype=np.bool_)
    buffer = np.empty(len(points))
    place = np.zeros(len(points))  # of a node along its own axis
    for axis in range(n_axes):
        if attach[axis] >= 0:
            n_laterals[parent[axis]] += 1
            is_foot[attach[axis]] = True
        for at in range(first[axis], first[axis + 1]):
            place[nodes[at]] = along[start[axis + 1] - first[axis + 1] + at]
    for axis in range(n_axes):
        mine, low, end = nodes[first[axis] : first[axis + 1]], start[axis], start[axis + 1]
        base, tip, total = mine[0], mine[len(mine) - 1], along[end - 1]
        skip = 0.0 if attach[axis] < 0 else min(radius[attach[axis]], 0.5 * total)
        window = max(LEAST_WINDOW_M, 4.0 * radius[base])
        near, far = skip, skip + window
        x, y, z = _direction(points, line[low:end], along[low:end], near, far)
        cosine = z
        if attach[axis] >= 0:
            below, above = start[parent[axis]], start[parent[axis] + 1]
            u, v, w = _through(
                points, line[below:above], along[below:above], place[attach[axis]], window
            )
            cosine = x * u + y * v + z * w
        row = table[axis]
        row[0] = total
        row[1] = _apart(points, line[end - 1], line[low])
        row[2] = 2.0 * _median_between(radius, place, mine, near, far, buffer)
        row[3] = 2.0 * _median_between(
            radius, place, mine, place[tip] - TIP_WINDOW_M, place[tip], buffer
        )
        row[4] = np.degrees(np.arccos(min(max(cosine, -1.0), 1.0)))
        row[5] = np.degrees(np.arctan2(y, x)) % 360.0
        row[6] = points[line[low], 2]
        row[7], row[8], row[9] = _wood(along[low:end], radius, mine)
        row[10] = n_laterals[axis]
        row[11], row[12] = _laterals(is_foot, place, mine, total, buffer)
        row[13] = _median_between(arc, place, mine, near, far, buffer)
        row[14] = _median_between(count, place, mine, near, far, buffer)
        row[15] = _share(gap, length, mine)
        row[16] = _median_between(residual, place, mine, near, far, buffer)
        row[17] = min(window, total - skip)
    return table


@numba.njit(cache=True)
def _share(gap: np.ndarray, length: np.ndarray, nodes: np.ndarray) -> float:
    """Share of the nodes' edges, by length, that bridge missing data."""
    bare = total = 0.0
    for node in nodes:
        total += length[node]
        bare += length[node] if gap[node] > 0 else 0.0
    return bare / max(total, 1e-12)


@numba.njit(cache=True)
def _wood(along: np.ndarray, radius: np.ndarray, nodes: np.ndarray) -> tuple[float, float, float]:
    """Mean diameter over the length, taper and volume, from the node that the axis hangs on."""
    n = len(along)
    before = n - len(nodes)  # 1 where it hangs on another's node, with its own first radius
    total, area, volume, middle = 0.0, 0.0, 0.0, 0.0
    for at in range(n):
        middle += along[at]
    middle, rise, run = middle / n, 0.0, 0.0
    for at in range(n):
        thin, offset = radius[nodes[max(at - before, 0)]], along[at] - middle
        rise, run = rise + offset * thin, run + offset * offset
        if at:
            step, thick = along[at] - along[at - 1], radius[nodes[max(at - 1 - before, 0)]]
            total += step
            area += step * (thick + thin)
            volume += np.pi / 3 * step * (thick * thick + thick * thin + thin * thin)
    taper = 0.0
    if n > 1 and along[-1] > along[0]:
        taper = -2e3 * (rise / run)
    return area / max(total, 1e-12), taper, volume


@numba.njit(cache=True)
def _laterals(
    is_foot: np.ndarray, place: np.ndarray, nodes: np.ndarray, end: float, buffer: np.ndarray
) -> tuple[float, float]:
    """Median way between successive laterals, NaN with fewer than two, and from the last on."""
    n, last = 0, 0.0
    for node in nodes:
        if is_foot[node]:
            if n:
                buffer[n - 1] = place[node] - last
            last = place[node]
            n += 1
    spacing = np.nan if n < 2 else median(buffer[: n - 1])
    return spacing, end - last


@numba.njit(cache=True)
def _median_between(
    values: np.ndarray,
    place: np.ndarray,
    nodes: np.ndarray,
    low: float,
    high: float,
    inside: np.ndarray,
) -> float:
    """Median over the nodes placed in a stretch of their axis; the nearest's where none is."""
    n, nearest = 0, nodes[0]
    middle = (low + high) / 2
    for node in nodes:
        if low - 1e-9 <= place[node] <= high + 1e-9:
            inside[n] = values[node]
            n += 1
        if abs(place[node] - middle) < abs(place[nearest] - middle):
            nearest = node
    return median(inside[:n]) if n else values[nearest]


@numba.njit(cache=True)
def _direction(
    points: np.ndarray, line: np.ndarray, along: np.ndarray, low: float, high: float
) -> tuple[float, float, float]:
    """Unit direction of a polyline over a stretch: a line fitted to even samples of it."""
    last = len(line) - 1
    if last < 1 or along[last] <= 0:
        return 0.0, 0.0, 1.0
    low, high = max(low, 0.0), min(high, along[last])
    if high - low < 1e-9:
        low, high = 0.0, along[last]
    slope, chord, row = np.zeros(3), np.zeros(3), 1
    for sample in range(N_SAMPLES):
        at = low + (high - low) * sample / (N_SAMPLES - 1)
        while row < last and along[row] < at:
            row += 1
        length = along[row] - along[row - 1]
        share = min(max((at - along[row - 1]) / length, 0.0), 1.0) if length > 0 else 0.0
        for axis in range(3):
            below = points[line[row - 1], axis]
            value = below + share * (points[line[row], axis] - below)
            slope[axis] += (at - (low + high) / 2) * value
            if sample == 0:
                chord[axis] -= value
            elif sample == N_SAMPLES - 1:
                chord[axis] += value
    # sum of the squares of even samples about their middle
    run = (high - low) ** 2 * N_SAMPLES * (N_SAMPLES + 1) / (12.0 * (N_SAMPLES - 1))
    norm = np.sqrt(slope[0] * slope[0] + slope[1] * slope[1] + slope[2] * slope[2])
    if norm / run < 1e-9:
        slope = chord
        norm = np.sqrt(chord[0] * chord[0] + chord[1] * chord[1] + chord[2] * chord[2])
        norm = max(norm, 1e-12)
    return slope[0] / norm, slope[1] / norm, slope[2] / norm


@numba.njit(cache=True)
def _through(
    points: np.ndarray, line: np.ndarray, along: np.ndarray, at: float, window: float
) -> tuple[float, float, float]:
    """Direction of an axis through one of its nodes at `at`, over `window` on either side."""
    low, high = at - window, at + window
    if at >= along[-1] - 1e-9:  # the axis ends here: only what lies below counts
        low = at - 2 * window
    return _direction(points, line, along, low, high)
