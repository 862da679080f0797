"""A skeleton as strands: one polyline an axis, to be straightened, re-attached and rebuilt."""

from dataclasses import dataclass

import numpy as np

from cherrypicker.skeleton.axes import axes as find_axes
from cherrypicker.skeleton.model import Skeleton, rooted_order

__all__ = ["Strand", "arc_length", "join_strands", "nearest_on_polyline", "split_strands"]


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
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


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
    if len(polyline) == 1:
        return np.zeros(len(points)), np.linalg.norm(points - polyline[0], axis=1)
    start, step = polyline[:-1], np.diff(polyline, axis=0)
    length = np.maximum(np.linalg.norm(step, axis=1), 1e-12)
    offset = points[:, None] - start[None]  # (m, n - 1, 3)
    share = np.clip(np.einsum("mnk,nk->mn", offset, step) / length**2, 0.0, 1.0)
    away = np.linalg.norm(offset - share[..., None] * step, axis=2)
    best = np.argmin(away, axis=1)
    rows = np.arange(len(points))
    at = arc_length(polyline)[best] + share[rows, best] * length[best]
    return at, away[rows, best]


def interpolate(strand_points, values, at):
    """Values along a polyline at given arc lengths (columns one by one)."""
    s = arc_length(strand_points)
    values = np.asarray(values, dtype=np.float64)
    if values.ndim == 1:
        return np.interp(at, s, values)
    return np.stack([np.interp(at, s, column) for column in values.T], axis=-1)


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
    length = float(s[-1])
    bare = np.flatnonzero(gap[1:] > 0)
    bare = bare[s[bare + 1] - s[bare] > spacing]
    stops = np.concatenate(
        [[0.0], np.sort(np.concatenate([wanted, s[bare], s[bare + 1]])), [length]]
    )
    merged = [0.0]
    for stop in stops[1:-1]:  # junctions closer than a third of the spacing share a node
        if stop - merged[-1] > spacing / 3 and length - stop > spacing / 3:
            merged.append(float(stop))
    merged.append(float(length))
    pieces = [np.zeros(1)]
    for a, b in zip(merged[:-1], merged[1:]):
        middle = np.searchsorted(s, (a + b) / 2) - 1
        n_steps = 1 if middle in bare else max(1, int(round((b - a) / spacing)))
        pieces.append(np.linspace(a, b, n_steps + 1)[1:])
    return np.concatenate(pieces)
