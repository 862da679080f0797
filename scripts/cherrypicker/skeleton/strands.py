"""A skeleton as strands: one polyline an axis, to be straightened, re-attached and rebuilt."""

from dataclasses import dataclass

import numba
import numpy as np

from cherrypicker.skeleton.axes import axes as find_axes
from cherrypicker.skeleton.local_frames import eigenvalue, eigenvector
from cherrypicker.skeleton.model import Skeleton, rooted_order

__all__ = [
    "Strand",
    "arc_length",
    "interpolate",
    "join_strands",
    "nearest_on_polyline",
    "split_strands",
    "straight_back",
]

N_PLACES = 81  # on a parent's axis that a side axis may start from


@dataclass
class Strand:
    """One axis while it is refined.

    Attributes
    ----------
    points : ndarray of shape (n, 3)
        From the base (for a side axis the point on its parent's axis) to the tip.
    radius, label : ndarray of shape (n,)
    gap : ndarray of shape (n,), int
        1 where the piece before the point bridges missing data.
    parent : int
        Index of the parent strand, -1 for the trunk.
    at : float
        Arc length on the parent's strand where this one starts.
    """

    points: np.ndarray
    radius: np.ndarray
    label: np.ndarray
    gap: np.ndarray
    parent: int
    at: float


def arc_length(points):
    """Arc length of each point of a polyline, (n,) float64, 0 at the first."""
    return _arc_length(np.ascontiguousarray(points, dtype=np.float64))


@numba.njit(cache=True)
def _arc_length(points):
    along = np.zeros(len(points))
    for row in range(1, len(points)):
        x = points[row, 0] - points[row - 1, 0]
        y = points[row, 1] - points[row - 1, 1]
        z = points[row, 2] - points[row - 1, 2]
        along[row] = along[row - 1] + np.sqrt(x * x + y * y + z * z)
    return along


def nearest_on_polyline(polyline, points):
    """Nearest place on a polyline for each point.

    Parameters
    ----------
    polyline : ndarray of shape (n, 3)
    points : ndarray of shape (m, 3)

    Returns
    -------
    at : ndarray of shape (m,)
        Arc length of the nearest place.
    distance : ndarray of shape (m,)
    """
    return _nearest(
        np.ascontiguousarray(polyline, dtype=np.float64),
        np.ascontiguousarray(points, dtype=np.float64),
    )


@numba.njit(cache=True)
def _nearest(line, points):
    place, distance = np.zeros(len(points)), np.full(len(points), np.inf)
    travelled = 0.0
    for piece in range(max(len(line) - 1, 1)):
        end = min(piece + 1, len(line) - 1)
        dx = line[end, 0] - line[piece, 0]
        dy = line[end, 1] - line[piece, 1]
        dz = line[end, 2] - line[piece, 2]
        squared = max(dx * dx + dy * dy + dz * dz, 1e-24)
        for row in range(len(points)):
            x = points[row, 0] - line[piece, 0]
            y = points[row, 1] - line[piece, 1]
            z = points[row, 2] - line[piece, 2]
            share = min(max((x * dx + y * dy + z * dz) / squared, 0.0), 1.0)
            x, y, z = x - share * dx, y - share * dy, z - share * dz
            away = x * x + y * y + z * z
            if away < distance[row]:
                distance[row], place[row] = away, travelled + share * np.sqrt(squared)
        travelled += np.sqrt(squared)
    return place, np.sqrt(distance)


def interpolate(strand_points, values, at):
    """Values along a polyline at given arc lengths (columns one by one)."""
    values = np.ascontiguousarray(values, dtype=np.float64)
    along = _arc_length(np.ascontiguousarray(strand_points))
    at = np.ascontiguousarray(at, dtype=np.float64)
    if values.ndim == 1:
        return np.interp(at, along, values)
    return _between(along, values, at)


@numba.njit(cache=True)
def _between(along, values, at):
    found = np.empty((len(at), values.shape[1]))
    for row in range(len(at)):
        above = min(max(np.searchsorted(along, at[row]), 1), len(along) - 1)
        below = max(above - 1, 0)
        length = along[above] - along[below]
        share = (at[row] - along[below]) / length if length > 0 else 0.0
        share = min(max(share, 0.0), 1.0)
        for column in range(values.shape[1]):
            step = values[above, column] - values[below, column]
            found[row, column] = values[below, column] + share * step
    return found


def straight_back(line, run, around, window, limit):
    """Place on a polyline that the straight continuation of a run of points backwards meets.

    Parameters
    ----------
    line : ndarray of shape (n, 3), float64
        The parent's axis.
    run : ndarray of shape (m, 3), float64
        Points outwards along the side axis.
    around, window : float
        Arc length on the line that is looked around, and how far either way.
    limit : float
        Largest distance between the line and the continuation.

    Returns
    -------
    place : float
        Arc length; NaN where the two do not meet.
    cosine : float
        Of the angle between the two there.
    """
    return _straight_back(
        np.ascontiguousarray(line), np.ascontiguousarray(run), around, window, limit
    )


@numba.njit(cache=True)
def _straight_back(line, run, around, window, limit):
    along = _arc_length(line)
    centre, direction = _direction(run)
    low, high = max(0.0, around - window), min(along[-1], around + window)
    spots = _between(along, line, low + (high - low) * np.arange(N_PLACES) / (N_PLACES - 1))
    best, least = -1, np.inf
    for row in range(N_PLACES):
        offset = spots[row] - centre
        ahead = (offset * direction).sum()
        aside = np.sqrt(max((offset * offset).sum() - ahead * ahead, 0.0))
        if ahead <= 0 and aside < least:  # only backwards
            best, least = row, aside
    if best < 0 or least > limit:
        return np.nan, 0.0
    step = spots[min(best + 1, N_PLACES - 1)] - spots[max(best - 1, 0)]
    cosine = abs((step * direction).sum()) / max(np.sqrt((step * step).sum()), 1e-12)
    return low + (high - low) * best / (N_PLACES - 1), cosine


@numba.njit(cache=True)
def _direction(run):
    """Middle and main direction of a run of points, from its first to its last."""
    n = len(run)
    centre = np.zeros(3)
    for row in range(n):
        centre += run[row] / n
    xx = yy = zz = xy = xz = yz = 0.0
    for row in range(n):
        x, y, z = run[row, 0] - centre[0], run[row, 1] - centre[1], run[row, 2] - centre[2]
        xx, yy, zz = xx + x * x, yy + y * y, zz + z * z
        xy, xz, yz = xy + x * y, xz + x * z, yz + y * z
    first = eigenvalue(xx, yy, zz, xy, xz, yz, True)
    direction = np.array(eigenvector(xx, yy, zz, xy, xz, yz, first))
    if (direction * (run[n - 1] - run[0])).sum() < 0:
        direction = -direction
    return centre, direction


def split_strands(skeleton):
    """Cut a skeleton into its axes, parents first.

    Parameters
    ----------
    skeleton : Skeleton

    Returns
    -------
    list of Strand
    """
    axis_list = find_axes(skeleton)
    gap = skeleton.fields.get("gap", np.zeros(len(skeleton), dtype=np.int64))
    position = np.zeros(len(skeleton))
    strands = []
    for axis in axis_list:
        nodes = axis.nodes if axis.attach < 0 else np.concatenate([[axis.attach], axis.nodes])
        points = skeleton.points[nodes]
        radius, label, bridged = skeleton.radius[nodes], skeleton.label[nodes], gap[nodes]
        if axis.attach >= 0:  # the attach node is the parent's: its own values come after it
            radius, label, bridged = radius.copy(), label.copy(), bridged.copy()
            radius[0], label[0], bridged[0] = radius[1], label[1], 0
        at = position[axis.attach] if axis.attach >= 0 else 0.0
        position[axis.nodes] = arc_length(points)[-len(axis.nodes) :]
        strands.append(Strand(points, radius, label, bridged, axis.parent, at))
    return strands


def join_strands(strands, spacing, *, unit, frame):
    """Sample strands evenly and join them into a skeleton.

    Every junction is a node of the parent's strand, put where the side strand starts.

    Parameters
    ----------
    strands : list of Strand
        Parents before children.
    spacing : float
    unit, frame : str

    Returns
    -------
    Skeleton
        With the field ``gap``.
    """
    children = [[] for _ in strands]
    for index, strand in enumerate(strands):
        if strand.parent >= 0:
            children[strand.parent].append(index)
    points, radius, label, gap, edges = [], [], [], [], []
    start_node = {0: None}
    total = 0
    for index, strand in enumerate(strands):
        s = arc_length(strand.points)
        wanted = [strands[child].at for child in children[index]]
        at = _stations(s, strand.gap, np.clip(wanted, 0, s[-1]), spacing)
        nearest = np.clip(np.searchsorted(s, at - 1e-12), 0, len(s) - 1)
        own = slice(0 if strand.parent < 0 else 1, None)  # a side strand starts in a parent's node
        ids = total + np.arange(len(at[own]))
        points.append(interpolate(strand.points, strand.points, at)[own])
        radius.append(interpolate(strand.points, strand.radius, at)[own])
        label.append(strand.label[nearest][own])
        gap.append(strand.gap[nearest][own])
        chain = ids if strand.parent < 0 else np.concatenate([[start_node[index]], ids])
        edges.append(np.stack([chain[:-1], chain[1:]], axis=1))
        for child, place in zip(children[index], np.clip(wanted, 0, s[-1])):
            start_node[child] = int(chain[np.argmin(np.abs(at - place))])
        total += len(ids)
    order, parent = rooted_order(total, np.vstack(edges), 0)
    return Skeleton(
        np.vstack(points)[order],
        parent,
        np.concatenate(radius)[order],
        np.concatenate(label)[order],
        {"gap": np.concatenate(gap)[order].astype(np.int64)},
        unit,
        frame,
    )


def _stations(s, gap, wanted, spacing):
    """Arc lengths of the nodes: the ends, the junctions, and even steps between them.

    Pieces that bridge missing data have no nodes of their own: none were seen there.
    """
    return _divided(s, gap, np.sort(wanted), spacing)


@numba.njit(cache=True)
def _divided(s, gap, wanted, spacing):
    n, length = len(s), s[-1]
    stops, n_stops = np.empty(2 * n + len(wanted) + 2), 0
    for row in range(1, n):
        if gap[row] > 0 and s[row] - s[row - 1] > spacing:
            stops[n_stops], stops[n_stops + 1] = s[row - 1], s[row]
            n_stops += 2
    stops[n_stops : n_stops + len(wanted)] = wanted
    stops = np.sort(stops[: n_stops + len(wanted)])
    merged, n_merged = np.zeros(len(stops) + 2), 1
    for stop in stops:  # junctions closer than a third of the spacing share a node
        if stop - merged[n_merged - 1] > spacing / 3 and length - stop > spacing / 3:
            merged[n_merged] = stop
            n_merged += 1
    merged[n_merged] = length
    at = np.zeros(1 + n_merged + int(length / spacing + n_merged))
    filled = 1
    for piece in range(n_merged):
        a, b = merged[piece], merged[piece + 1]
        middle = np.searchsorted(s, (a + b) / 2)
        is_bare = 0 < middle < n and gap[middle] > 0 and s[middle] - s[middle - 1] > spacing
        n_steps = 1 if is_bare else max(1, int(np.rint((b - a) / spacing)))
        for step in range(1, n_steps + 1):
            at[filled] = a + (b - a) * step / n_steps
            filled += 1
    return at[:filled]
