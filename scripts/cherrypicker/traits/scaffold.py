"""The limbs of a tree: axes that leave its stem, and how thick they are beyond its surface.

An axis leaves the stem inside the stem's wood, and may run along it for a while: it is followed to
where it first is clear of the stem, and back to where it came out. A calliper is put on a limb
2.5 cm beyond the stem's surface (Schupp et al., HortScience 52(9):1233-1240, 2017), so its diameter
is taken there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.skeleton.axes import Axis, axis_polyline
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.branch_shapes import LEAST_WINDOW_M
from cherrypicker.traits.support import densify

BEYOND_M = 0.025  # beyond the stem's surface: where a limb is measured (Schupp 2017)
_STEP_M = 0.005  # along a limb and along the stem
# A leader's section is so many times those of all other axes of a fork (of two it is 1.4 times as
# thick), between so many of the trunk's radii above it; guesses
_LEADS, _FORK_RADII = 2.0, (2.0, 6.0)


@dataclass(frozen=True)
class Limb:
    """An axis that leaves the stem, in the skeleton's unit."""

    axis: int  # its row in the list of axes
    stem_node: int  # node of the stem beside which it comes out of the stem's surface
    # place, direction: (3,) float64: where it is measured, and the way that it runs there
    place: np.ndarray
    direction: np.ndarray
    # diameter, beyond: of its nodes there, and their median over a stretch that begins there
    diameter: float
    beyond: float
    # error, scatter: standard error of a radius of that stretch by its fit and spread of the points
    # around it, 0 where the skeleton does not know them
    error: float
    scatter: float


class StemSurface:
    """The surface of a stem, to tell how far outside it something lies."""

    def __init__(self, skeleton: Skeleton, axis_list: list[Axis]) -> None:
        points, node, radius, _ = densify(skeleton, _STEP_M)
        self.axes = _stem_axes(skeleton, axis_list)
        of_stem = np.isin(node, np.concatenate([axis_list[axis].nodes for axis in self.axes]))
        self._tree, self._node = cKDTree(points[of_stem]), node[of_stem]
        self._radius = radius[of_stem]

    def over(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far points (n, 3) lie outside it, and the stem's node beside each, (n,) both."""
        away, row = self._tree.query(points)
        return away - self._radius[row], self._node[row]


def _stem_axes(skeleton: Skeleton, axis_list: list[Axis]) -> list[int]:
    """The trunk and, where it ends below a leader, that axis: a leader is no limb.

    A burl below a fork may end the trunk by its radii; the leader still has more wood than all
    other axes of the fork.
    """
    end = axis_list[0].nodes[-1]
    low, high = (times * skeleton.radius[end] for times in _FORK_RADII)
    length, fork, areas = skeleton.edge_length, {end}, {}
    for index, axis in enumerate(axis_list):
        if axis.attach not in fork:
            continue
        along = np.cumsum(length[axis.nodes])
        fork.update(axis.nodes[along < low].tolist())
        stretch = axis.nodes[(along >= low) & (along <= high)]
        if len(stretch) and along[-1] >= high:  # no stub
            areas[index] = float(np.median(skeleton.radius[stretch]) ** 2)
    leader = max(areas, key=areas.__getitem__, default=-1)
    if leader < 0 or areas[leader] <= _LEADS * (sum(areas.values()) - areas[leader]):
        return [0]
    return [0, leader]


def find_limbs(
    skeleton: Skeleton,
    axis_list: list[Axis],
    stem: StemSurface,
    *,
    least: float,
    kept: np.ndarray | None = None,
) -> list[Limb]:
    """Find the limbs of a tree.

    Parameters
    ----------
    axis_list : list of Axis
        From `cherrypicker.skeleton.axes`; the trunk first.
    stem : StemSurface
    least : float
        An axis that never is farther than this from the stem's surface is a stub or a spur.
    kept : ndarray of shape (n_nodes,), bool, optional
        Nodes that belong to the tree; all without it.

    Returns
    -------
    list of Limb
        In the order of the axes.
    """
    kept = np.ones(len(skeleton), dtype=bool) if kept is None else kept
    of_stem = np.zeros(len(skeleton), dtype=bool)
    for index in stem.axes:
        of_stem[axis_list[index].nodes] = True
    limbs = []
    for index, axis in enumerate(axis_list):
        if index in stem.axes or not of_stem[axis.attach]:
            continue
        limb, n_stem = _limb(skeleton, axis, index, stem, least, kept)
        of_stem[axis.nodes[:n_stem]] = True
        if limb is not None:
            limbs.append(limb)
    return limbs


def _limb(
    skeleton: Skeleton,
    axis: Axis,
    index: int,
    stem: StemSurface,
    least: float,
    kept: np.ndarray,
) -> tuple[Limb | None, int]:
    """The limb that an axis is, None where it stays at the stem, and how many nodes are the stem's.

    What leaves an axis below where it is measured, or leaves a stub, is a limb of its own.
    """
    way = axis_polyline(axis)
    way = way[kept[way]]
    if len(way) < 2:
        return None, len(axis.nodes)
    points = skeleton.points[way]
    place = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    along = np.arange(0.0, place[-1], _STEP_M)
    over, beside = stem.over(np.column_stack([np.interp(along, place, xyz) for xyz in points.T]))
    clear = np.flatnonzero(over >= least)
    if not len(clear):
        return None, len(axis.nodes)
    inside = np.flatnonzero(over[: clear[0]] <= 0.0)
    leaves = int(inside[-1]) if len(inside) else 0
    at = along[leaves] + BEYOND_M
    own, place = way[1:], place[1:]  # its first node is the stem's
    diameter = 2.0 * float(np.interp(at, place, skeleton.radius[own]))
    far = at + max(LEAST_WINDOW_M, 2.0 * diameter)
    stretch = own[(place >= at) & (place <= far)]
    stretch = stretch if len(stretch) else own[-1:]
    low, middle, high = (
        np.array([np.interp(each, place, xyz) for xyz in skeleton.points[own].T])
        for each in (at - BEYOND_M, at, at + 2 * BEYOND_M)
    )
    none = np.zeros(len(skeleton))
    limb = Limb(
        index,
        int(beside[leaves]),
        middle,
        (high - low) / max(float(np.linalg.norm(high - low)), 1e-12),
        diameter,
        2.0 * float(np.median(skeleton.radius[stretch])),
        float(np.median(skeleton.fields.get("radius_error", none)[stretch])),
        float(np.median(skeleton.fields.get("residual", none)[stretch])),
    )
    return limb, int((place < at).sum())


def crown_start(axis_list: list[Axis], limbs: list[Limb], stem: StemSurface) -> int:
    """Node of the stem from which the crown begins, -1 where nothing leaves the stem.

    There its lowest limb comes out of it; without limbs, as on a young tree, its lowest side axis.
    """
    if limbs:
        return min(limb.stem_node for limb in limbs)  # parents come before children
    trunk = {int(node) for axis in stem.axes for node in axis_list[axis].nodes}
    sides = (axis for index, axis in enumerate(axis_list) if index not in stem.axes)
    return min((axis.attach for axis in sides if axis.attach in trunk), default=-1)


def clear_stem(
    skeleton: Skeleton, axis_list: list[Axis], limbs: list[Limb], stem: StemSurface
) -> np.ndarray:
    """Nodes below the crown, (n_nodes,) bool: the stem up to its lowest limb, and stubs on it.

    All nodes where nothing leaves the stem. What of a limb lies within the stem's surface is the
    stem's.
    """
    base = crown_start(axis_list, limbs, stem)
    if base < 0:
        return np.ones(len(skeleton), dtype=bool)
    trunk = np.concatenate([axis_list[axis].nodes for axis in stem.axes])
    is_clear = np.zeros(len(skeleton), dtype=bool)
    is_clear[trunk[trunk <= base]] = True
    goes_up = np.full(len(axis_list), not limbs)
    goes_up[[*stem.axes, *(limb.axis for limb in limbs)]] = True
    for index, axis in enumerate(axis_list):
        if not goes_up[index] and is_clear[axis.attach]:
            is_clear[axis.nodes] = True
    over, beside = stem.over(skeleton.points)
    return is_clear | ((over <= 0.0) & (beside <= base))
