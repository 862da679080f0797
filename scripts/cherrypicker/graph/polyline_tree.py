"""A skeleton as strands: one polyline an axis, to be straightened, re-attached and rebuilt."""

from dataclasses import dataclass

import numba
import numpy as np

from cherrypicker.geometry.ordering import first_not_below, sort_in_place
from cherrypicker.geometry.polylines import along_polyline, between
from cherrypicker.geometry.tree_walks import child_rows
from cherrypicker.skeleton.axes import axis_runs
from cherrypicker.skeleton.model import Skeleton, rooted_order

__all__ = [
    "Strands",
    "grown",
    "join_strands",
    "split_strands",
]


@dataclass
class Strands:
    """The axes of a tree while they are refined, as polylines one after the other.

    Attributes
    ----------
    points : ndarray of shape (n, 3), float64
        Each strand from its base (for a side axis the point on its parent's axis) to its tip.
    radius : ndarray of shape (n,), float64
    label : ndarray of shape (n,), int64
    gap : ndarray of shape (n,), int64
        1 where the piece before the point bridges missing data.
    start : ndarray of shape (n_strands + 1,), int64
        Strand i has the rows from ``start[i]`` to ``start[i + 1]``.
    parent : ndarray of shape (n_strands,), int64
        Parent strand of each, before its own; -1 for the trunk, which is the first.
    at : ndarray of shape (n_strands,), float64
        Arc length on the parent's strand where each starts.
    """

    points: np.ndarray
    radius: np.ndarray
    label: np.ndarray
    gap: np.ndarray
    start: np.ndarray
    parent: np.ndarray
    at: np.ndarray

    def __len__(self):
        return len(self.parent)

    def rows(self, index):
        """Slice of the rows of one strand."""
        return slice(self.start[index], self.start[index + 1])

    def with_more(self, more):
        """Strands with further side axes, dicts of the columns of one strand each, at the end."""
        columns = {
            name: np.concatenate([getattr(self, name), *(one[name] for one in more)])
            for name in ("points", "radius", "label", "gap")
        }
        sizes = [len(one["points"]) for one in more]
        start = np.concatenate([self.start, self.start[-1] + np.cumsum(sizes, dtype=np.int64)])
        parent = np.append(self.parent, [one["parent"] for one in more]).astype(np.int64)
        return Strands(
            **columns,
            start=start,
            parent=parent,
            at=np.append(self.at, [one["at"] for one in more]),
        )


def split_strands(skeleton):
    """Cut a skeleton into its axes, parents first.

    Parameters
    ----------
    skeleton : Skeleton

    Returns
    -------
    Strands
    """
    nodes, first, _, parent, attach = axis_runs(skeleton)
    gap = skeleton.fields.get("gap", np.zeros(len(skeleton), dtype=np.int64))
    row = np.insert(nodes, first[1:-1], attach[1:])  # a side axis starts in its parent's node
    start = first + np.maximum(np.arange(len(first)) - 1, 0)
    points, radius, label = skeleton.points[row], skeleton.radius[row], skeleton.label[row]
    gap = gap[row].astype(np.int64)
    head = start[1:-1]
    radius[head], label[head], gap[head] = radius[head + 1], label[head + 1], 0  # its own values
    position = np.zeros(len(skeleton))
    own = np.ones(len(row), dtype=bool)
    own[head] = False
    position[nodes] = _along_each(points, start)[own]
    at = np.where(attach >= 0, position[attach], 0.0)
    return Strands(points, radius, label, gap, start, parent, at)


@numba.njit(cache=True)
def _along_each(points, start):
    """Arc length of each point of several polylines."""
    along = np.empty(len(points))
    for index in range(len(start) - 1):
        a, b = start[index], start[index + 1]
        own = along_polyline(points[a:b])
        for row in range(a, b):
            along[row] = own[row - a]
    return along


def join_strands(strands, spacing, *, unit, frame):
    """Sample strands evenly and join them into a skeleton.

    Every junction is a node of the parent's strand, put where the side strand starts.

    Parameters
    ----------
    strands : Strands
    spacing : float
    unit, frame : str

    Returns
    -------
    Skeleton
        With the field ``gap``.
    """
    columns = strands.points, strands.radius, strands.label, strands.gap
    table = np.ascontiguousarray(np.column_stack(columns), dtype=np.float64)
    table = _sampled(table, strands.start, strands.parent, strands.at, float(spacing))
    values, kinds, above = (
        table[:, :4],
        table[:, 4:6].astype(np.int64),
        table[:, 6].astype(np.int64),
    )
    edges = np.stack([above[1:], np.arange(1, len(above))], axis=1)
    order, parent = rooted_order(len(above), edges, 0)
    values, kinds = values[order], kinds[order]
    gap = {"gap": kinds[:, 1].copy()}
    return Skeleton(
        values[:, :3].copy(), parent, values[:, 3].copy(), kinds[:, 0].copy(), gap, unit, frame
    )


@numba.njit(cache=True)
def grown(table, n):
    """A table of floats with at least `n` rows: itself, or one of twice that with its rows."""
    if n <= len(table):
        return table
    larger = np.empty((2 * n, table.shape[1]))
    for row in range(len(table)):
        for column in range(table.shape[1]):
            larger[row, column] = table[row, column]
    return larger


@numba.njit(cache=True)
def _sampled(columns, start, parent, at, spacing):
    """Nodes of the joined strands: x, y, z, radius, label, gap, and the node below each.

    `columns` (n, 6) are the first six of these, strand after strand.
    """
    table, total = np.empty((len(columns), 7)), 0
    side_start, side = child_rows(parent)
    base = np.full(len(parent), -1, dtype=np.int64)
    for index in range(len(parent)):
        line = columns[start[index] : start[index + 1]]
        s = along_polyline(line)
        sides = side[side_start[index] : side_start[index + 1]]
        wanted = np.empty(len(sides))
        for row in range(len(sides)):
            wanted[row] = min(max(at[sides[row]], 0.0), s[-1])
        places = _stations(s, line, wanted, spacing)
        first = 0 if index == 0 else 1  # a side strand starts in a node of its parent's
        n_own = len(places) - first
        table = grown(table, total + n_own)
        spots = between(s, line, places)
        for row in range(first, len(places)):
            node = total + row - first
            near = min(first_not_below(s, places[row] - 1e-12), len(line) - 1)
            for column in range(4):
                table[node, column] = spots[row, column]
            table[node, 4], table[node, 5] = line[near, 4], line[near, 5]
            table[node, 6] = node - 1 if row > first else base[index]
        for row in range(len(sides)):
            nearest = _nearest(places, wanted[row])
            base[sides[row]] = base[index] if nearest < first else total + nearest - first
        total += n_own
    return table[:total]


@numba.njit(cache=True)
def _nearest(places, wanted):
    """First of the places that is nearest to the wanted one."""
    best = 0
    for row in range(1, len(places)):
        if abs(places[row] - wanted) < abs(places[best] - wanted):
            best = row
    return best


@numba.njit(cache=True)
def _stations(s, line, wanted, spacing):
    """Arc lengths of the nodes: the ends, the junctions, and even steps between them.

    Pieces that bridge missing data have no nodes of their own: none were seen there.
    """
    n, length = len(s), s[-1]
    stops, n_stops = np.empty(2 * n + len(wanted) + 2), 0
    for row in range(1, n):
        if line[row, 5] > 0 and s[row] - s[row - 1] > spacing:
            stops[n_stops], stops[n_stops + 1] = s[row - 1], s[row]
            n_stops += 2
    for place in wanted:
        stops[n_stops] = place
        n_stops += 1
    sort_in_place(stops[:n_stops])
    merged, n_merged = np.zeros(n_stops + 2), 1
    for row in range(n_stops):  # junctions closer than a third of the spacing share a node
        stop = stops[row]
        if stop - merged[n_merged - 1] > spacing / 3 and length - stop > spacing / 3:
            merged[n_merged] = stop
            n_merged += 1
    merged[n_merged] = length
    at = np.zeros(1 + n_merged + int(length / spacing + n_merged))
    filled = 1
    for piece in range(n_merged):
        a, b = merged[piece], merged[piece + 1]
        middle = first_not_below(s, (a + b) / 2)
        is_bare = 0 < middle < n and line[middle, 5] > 0 and s[middle] - s[middle - 1] > spacing
        n_steps = 1 if is_bare else max(1, int(np.rint((b - a) / spacing)))
        for step in range(1, n_steps + 1):
            at[filled] = a + (b - a) * step / n_steps
            filled += 1
    return at[:filled]
