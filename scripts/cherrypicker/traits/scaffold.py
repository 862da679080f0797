"""The limbs of a tree: axes that leave its stem, and how thick they are beyond its surface.

An axis leaves the stem inside the stem's wood, and may run along it for a while: it is followed to
where it first is clear of the stem, and back to where it came out. A calliper is put on a limb
2.5 cm beyond the stem's surface (Schupp et al., HortScience 52(9):1233-1240, 2017), so its diameter
is taken there. Where a fork ends the stem, as on a vase, its surface is drawn on as a cylinder: the
limbs leave it sideways, about where they part from one another, and that place does not move with
the node that a skeleton gives the fork.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.skeleton.axes import Axis, axis_polyline
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.skeleton.samples import densify
from cherrypicker.traits.branch_shapes import LEAST_WINDOW_M

BEYOND_M = 0.025  # beyond the stem's surface: where a limb is measured (Schupp 2017)
_STEP_M = 0.005  # along a limb and along the stem
# A leader's section is so many times those of all other axes of a fork (of two it is 1.4 times as
# thick), between so many of the trunk's radii above it; guesses
_LEADS, _FORK_RADII = 2.0, (2.0, 6.0)
# A stem that a fork ends is drawn on over so many of its radii (guess): what leans by 15 degrees
# and more leaves its surface within them
_DRAWN_ON = 4.0


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
        end = axis_list[self.axes[-1]].nodes
        further, wide = _drawn_on(skeleton, end)
        self._tree = cKDTree(np.vstack([points[of_stem], further]))
        self._node = np.append(node[of_stem], np.full(len(further), end[-1]))
        self._radius = np.append(radius[of_stem], np.full(len(further), wide))

    def over(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far points (n, 3) lie outside it, and the stem's node beside each, (n,) both."""
        away, row = self._tree.query(points)
        return away - self._radius[row], self._node[row]


def _drawn_on(skeleton: Skeleton, nodes: np.ndarray) -> tuple[np.ndarray, float]:
    """Samples (n, 3) of a stem's axis beyond the fork that ends it, and its radius there.

    None beyond a tip. The radius is the median of as long a stretch below: within a fork radii are
    no one's own.
    """
    end = nodes[-1]
    if not skeleton.n_children[end]:
        return np.zeros((0, 3)), 0.0
    points, reach = skeleton.points[nodes], _DRAWN_ON * skeleton.radius[end]
    near = np.linalg.norm(points - points[-1], axis=1) <= reach
    rise = points[-1] - points[near][0]
    along = np.arange(_STEP_M, reach, _STEP_M)
    further = points[-1] + along[:, None] * rise / max(float(np.linalg.norm(rise)), 1e-12)
    return further, float(np.median(skeleton.radius[nodes[near]]))


def _section_beyond(skeleton: Skeleton, nodes: np.ndarray, fork: int) -> float:
    """Squared radius of the wood of `nodes`, which begin beyond a fork; 0 where it is a stub."""
    low, high = (times * skeleton.radius[fork] for times in _FORK_RADII)
    along = np.cumsum(skeleton.edge_length[nodes])
    stretch = nodes[(along >= low) & (along <= high)]
    if not len(stretch) or along[-1] < high:
        return 0.0
    return float(np.median(skeleton.radius[stretch]) ** 2)


def _stem_axes(skeleton: Skeleton, axis_list: list[Axis]) -> list[int]:
    """The trunk and, where it ends below a leader, that axis: a leader is no limb.

    A burl below a fork may end the trunk by its radii; the leader still has more wood than all
    other axes of the fork.
    """
    end = axis_list[0].nodes[-1]
    low = _FORK_RADII[0] * skeleton.radius[end]
    fork, areas = {end}, {}
    for index, axis in enumerate(axis_list):
        if axis.attach not in fork:
            continue
        along = np.cumsum(skeleton.edge_length[axis.nodes])
        fork.update(axis.nodes[along < low].tolist())
        if section := _section_beyond(skeleton, axis.nodes, end):
            areas[index] = section
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
        In the order of the axes. What leaves the stem, or a stub on it, and comes clear of it; and
        what hangs on such a limb, but parts from it at the stem and is no lateral of it.
    """
    kept = np.ones(len(skeleton), dtype=bool) if kept is None else kept
    of_stem = np.zeros(len(skeleton), dtype=bool)
    for index in stem.axes:
        of_stem[axis_list[index].nodes] = True
    limbs: list[Limb] = []
    for index, axis in enumerate(axis_list):
        bearer = next((limb for limb in limbs if limb.axis == axis.parent), None)
        if index in stem.axes or not (of_stem[axis.attach] or bearer is not None):
            continue
        if bearer is not None and not _parts_at_the_stem(skeleton, axis_list, axis, stem):
            continue
        limb = _limb(skeleton, axis, index, stem, least, kept)
        if limb is None:
            of_stem[axis.nodes] = True
        else:
            limbs.append(limb)
    return limbs


def _parts_at_the_stem(
    skeleton: Skeleton, axis_list: list[Axis], axis: Axis, stem: StemSurface
) -> bool:
    """Whether an axis that hangs on a limb is a limb of the same fork and no lateral.

    Its wood comes as near to the stem as where limbs are measured, and the limb does not lead it.
    """
    own = _section_beyond(skeleton, axis.nodes, axis.attach)
    over, _ = stem.over(skeleton.points[[axis.attach]])
    if over[0] - np.sqrt(own) > BEYOND_M:
        return False
    bearer = axis_list[axis.parent].nodes
    further = bearer[np.flatnonzero(bearer == axis.attach)[0] + 1 :]
    return _section_beyond(skeleton, further, axis.attach) <= _LEADS * own


def _limb(
    skeleton: Skeleton,
    axis: Axis,
    index: int,
    stem: StemSurface,
    least: float,
    kept: np.ndarray,
) -> Limb | None:
    """The limb that an axis is, None where it stays at the stem or was mostly not seen."""
    way = axis_polyline(axis)
    way = way[kept[way]]
    # Its first nodes may have the stem's points: a bridge into empty air has no more than those
    is_seen = skeleton.fields.get("n_points", np.ones(len(skeleton))) > 0
    if len(way) < 2 or not np.median(is_seen[way[1:]]):
        return None
    points = skeleton.points[way]
    place = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    along = np.arange(0.0, place[-1], _STEP_M)
    over, beside = stem.over(np.column_stack([np.interp(along, place, xyz) for xyz in points.T]))
    clear = np.flatnonzero(over >= least)
    if not len(clear):
        return None
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
    return Limb(
        index,
        int(beside[leaves]),
        middle,
        (high - low) / max(float(np.linalg.norm(high - low)), 1e-12),
        diameter,
        2.0 * float(np.median(skeleton.radius[stretch])),
        float(np.median(skeleton.fields.get("radius_error", none)[stretch])),
        float(np.median(skeleton.fields.get("residual", none)[stretch])),
    )


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
