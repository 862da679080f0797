"""Shapes of all axes of a skeleton in one compiled pass: lengths, directions, radii, laterals."""

import numba
import numpy as np

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


def axis_shapes(skeleton, axis_list):
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
    table = _shapes(points, radius, length, *fields, nodes, first, attach, parent, *lines)
    return dict(zip(SHAPE_COLUMNS, table.T, strict=True))


@numba.njit(cache=True)
def _lines(points, nodes, first, attach):
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
            step = points[line[at]] - points[line[at - 1]]
            along[at] = along[at - 1] + np.sqrt((step * step).sum())
    start[n_axes] = filled
    return line[:filled], along[:filled], start


@numba.njit(cache=True)
def _shapes(
    points, radius, length, arc, count, residual, gap, nodes, first, attach, parent, line, along,
    start,
):  # fmt: skip
    """The table of `axis_shapes`, (n_axes, n_columns)."""
    n_axes = len(attach)
    table = np.empty((n_axes, 18))
    n_laterals, is_foot = np.zeros(n_axes), np.zeros(len(points), dtype=np.bool_)
    place = np.zeros(len(points))  # of a node along its own axis
    for axis in range(n_axes):
        if attach[axis] >= 0:
            n_laterals[parent[axis]] += 1
            is_foot[attach[axis]] = True
        own = first[axis + 1] - first[axis]
        place[nodes[first[axis] : first[axis + 1]]] = along[start[axis + 1] - own : start[axis + 1]]
    for axis in range(n_axes):
        mine = nodes[first[axis] : first[axis + 1]]
        way, s = points[line[start[axis] : start[axis + 1]]], along[start[axis] : start[axis + 1]]
        own, r, is_trunk = place[mine], radius[mine], attach[axis] < 0
        skip = 0.0 if is_trunk else min(radius[attach[axis]], 0.5 * s[-1])
        window = max(LEAST_WINDOW_M, 4.0 * r[0])
        low, high = skip, skip + window
        direction = _direction(way, s, low, high)
        if is_trunk:
            reference = np.array([0.0, 0.0, 1.0])
        else:
            above = slice(start[parent[axis]], start[parent[axis] + 1])
            reference = _through(points[line[above]], along[above], place[attach[axis]], window)
        cosine = min(max((direction * reference).sum(), -1.0), 1.0)
        row = table[axis]
        row[0] = s[-1]
        row[1] = np.sqrt(((way[-1] - way[0]) ** 2).sum())
        row[2] = 2.0 * _median_between(r, own, low, high)
        row[3] = 2.0 * _median_between(r, own, own[-1] - TIP_WINDOW_M, own[-1])
        row[4] = np.degrees(np.arccos(cosine))
        row[5] = np.degrees(np.arctan2(direction[1], direction[0])) % 360.0
        row[6] = way[0, 2]
        row[7], row[8], row[9] = _wood(s, own, r)
        row[10] = n_laterals[axis]
        row[11], row[12] = _laterals(own[is_foot[mine]], s[-1])
        row[13] = _median_between(arc[mine], own, low, high)
        row[14] = _median_between(count[mine], own, low, high)
        row[15] = length[mine][gap[mine] > 0].sum() / max(length[mine].sum(), 1e-12)
        row[16] = _median_between(residual[mine], own, low, high)
        row[17] = min(window, s[-1] - skip)
    return table


@numba.njit(cache=True)
def _wood(along, own, radius):
    """Mean diameter over the length, taper and volume, from the node that the axis hangs on."""
    n = len(along)
    r = np.empty(n)
    r[0] = radius[0]  # where the axis hangs on another's node, with its own first radius
    r[n - len(own) :] = radius
    total, area, volume = 0.0, 0.0, 0.0
    for at in range(1, n):
        step, thick, thin = along[at] - along[at - 1], r[at - 1], r[at]
        total += step
        area += step * (thick + thin)
        volume += np.pi / 3 * step * (thick * thick + thick * thin + thin * thin)
    taper = 0.0
    if n > 1 and along[-1] > along[0]:
        taper = -2e3 * _slope(along, r)
    return area / max(total, 1e-12), taper, volume


@numba.njit(cache=True)
def _laterals(places, end):
    """Median way between successive laterals, NaN with fewer than two, and from the last on."""
    if not len(places):
        return np.nan, end
    spacing = np.nan if len(places) < 2 else np.median(np.diff(places))
    return spacing, end - places[-1]


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
    """Slope of the line through values over their positions, both (n,) float64."""
    offset = at - at.mean()
    return (offset * values).sum() / (offset * offset).sum()


@numba.njit(cache=True)
def _direction(points, along, low, high):
    """Unit direction of a polyline over a stretch: a line fitted to even samples of it."""
    if len(points) < 2 or along[-1] <= 0:
        return np.array([0.0, 0.0, 1.0])
    low, high = max(low, 0.0), min(high, along[-1])
    if high - low < 1e-9:
        low, high = 0.0, along[-1]
    at = low + (high - low) * np.arange(12) / 11
    slope, chord = np.empty(3), np.empty(3)
    for column in range(3):
        samples = np.interp(at, along, np.ascontiguousarray(points[:, column]))
        slope[column], chord[column] = _slope(at, samples), samples[-1] - samples[0]
    norm = np.sqrt((slope * slope).sum())
    if norm < 1e-9:
        return chord / max(np.sqrt((chord * chord).sum()), 1e-12)
    return slope / norm


@numba.njit(cache=True)
def _through(points, along, at, window):
    """Direction of an axis through one of its nodes at `at`, over `window` on either side."""
    low, high = at - window, at + window
    if at >= along[-1] - 1e-9:  # the axis ends here: only what lies below counts
        low = at - 2 * window
    return _direction(points, along, low, high)
