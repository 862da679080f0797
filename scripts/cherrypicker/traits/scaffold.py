"""The limbs of a tree: axes that leave its stem, and how thick they are beyond its surface.

An axis leaves the stem inside the stem's wood, and may run along it for a while: it is followed to
where it first is clear of the stem, and back to where it came out. A calliper is put on a limb
2.5 cm beyond the stem's surface (Schupp et al., HortScience 52(9):1233-1240, 2017), so its diameter
is taken there. Where a fork ends the stem, as on a vase, its surface is drawn on as a cylinder: the
limbs leave it sideways, about where they part from one another, and that place does not move with
the node that a skeleton gives the fork.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.geometry.lines import Line
from cherrypicker.skeleton import Axis, Skeleton, densify
from cherrypicker.skeleton import axes as find_axes
from cherrypicker.skeleton.axis_radii import typical_scatter
from cherrypicker.traits.branches import LEAST_WINDOW_M
from cherrypicker.traits.support import STEP_M

BEYOND_M = 0.025  # beyond the stem's surface: where a limb is measured (Schupp 2017)
# A leader's section is so many times those of all other axes of a fork (of two it is 1.4 times as
# thick), between so many of the trunk's radii above it; over as many a stem that a fork ends is
# drawn on: what leans by 15 degrees and more leaves its surface within them. On 24 trees 0.25 limbs
# a tree lack or are too many: 0.46 where a leader need but be thicker, 0.33 at twice the ratio,
# 0.79 without leaders; 0.42 within half the radii, 0.25 within twice
_LEADS, _FORK_RADII = 2.0, (2.0, 4.0)


@dataclass(frozen=True)
class Limb:
    """An axis that leaves the stem, in the skeleton's unit."""

    axis: int  # its row in the list of axes
    stem_node: int  # node of the stem beside which it comes out of the stem's surface
    place: np.ndarray  # (3,) float64: where it is measured
    diameter: float  # of the skeleton there
    # error, scatter: standard error of a radius by its fit and spread of the points around it, over
    # a stretch that begins there; 0 where the skeleton does not know them
    error: float
    scatter: float


class Scaffold:
    """A tree's stem with its surface, and the limbs that leave it.

    An axis that never is farther than `least` from the stem's surface is a stub or a spur. Nodes
    that are not `kept`, (n_nodes,) bool, belong to no tree.

    Attributes
    ----------
    axes : list of Axis
        Of the skeleton, the trunk first.
    stem : list of int
        The trunk and, where it ends below a leader, that axis: a leader is no limb.
    limbs : list of Limb
        In the order of the axes. What leaves the stem, or a stub on it, and comes clear of it; and
        what hangs on such a limb, but parts from it at the stem and is no lateral of it.
    """

    def __init__(self, skeleton: Skeleton, *, least: float, kept: np.ndarray | None = None) -> None:
        self.skeleton, self.axes = skeleton, find_axes(skeleton)
        self.stem = self._stem_axes()
        points, node, radius, _ = densify(skeleton, STEP_M)
        at_stem = np.zeros(len(skeleton), dtype=bool)
        at_stem[self._nodes_of(self.stem)] = True
        of_stem = at_stem[node]
        # A stem that a fork ends is drawn on, as thick as the median of a stretch as long below:
        # within a fork radii are no one's own
        nodes, radii = self.axes[self.stem[-1]].nodes, skeleton.radius
        end, further, wide = nodes[-1], np.zeros((0, 3)), 0.0
        if skeleton.n_children[end]:
            own, reach = skeleton.points[nodes], _FORK_RADII[1] * radii[end]
            near = np.linalg.norm(own - own[-1], axis=1) <= reach
            rise = own[-1] - own[near][0]
            along = np.arange(STEP_M, reach, STEP_M)
            further = own[-1] + along[:, None] * rise / max(float(np.linalg.norm(rise)), 1e-12)
            wide = float(np.median(radii[nodes[near]]))
        self._surface = cKDTree(np.vstack([points[of_stem], further]))
        self._node = np.append(node[of_stem], np.full(len(further), end))
        self._radius = np.append(radius[of_stem], np.full(len(further), wide))
        kept = np.ones(len(skeleton), dtype=bool) if kept is None else kept
        limbs: dict[int, Limb] = {}
        for index, axis in enumerate(self.axes):
            if index in self.stem:
                continue
            if at_stem[axis.attach] or (axis.parent in limbs and self._parts_at_the_stem(axis)):
                limb = self._limb(index, least, kept)
                if limb is None:
                    at_stem[axis.nodes] = True
                else:
                    limbs[index] = limb
        self.limbs = list(limbs.values())

    def _nodes_of(self, axes: list[int]) -> np.ndarray:
        return np.concatenate([self.axes[axis].nodes for axis in axes])

    def _stem_axes(self) -> list[int]:
        """The trunk, and the leader that goes on above it.

        A burl below a fork may end the trunk by its radii; the leader still has more wood than all
        other axes of the fork.
        """
        end = self.axes[0].nodes[-1]
        low = _FORK_RADII[0] * self.skeleton.radius[end]
        fork, areas = {end}, {}
        for index, axis in enumerate(self.axes):
            if axis.attach in fork:
                along = np.cumsum(self.skeleton.edge_length[axis.nodes])
                fork.update(axis.nodes[along < low].tolist())
                areas[index] = self._section_beyond(axis.nodes, end)
        leader = max(areas, key=areas.__getitem__, default=0)
        others = sum(areas.values()) - areas.get(leader, 0.0)
        return [0, leader] if areas.get(leader, 0.0) > _LEADS * others else [0]

    def _section_beyond(self, nodes: np.ndarray, fork: int) -> float:
        """Squared radius of the wood of `nodes`, which begin beyond a fork; 0 of a stub."""
        low, high = (times * self.skeleton.radius[fork] for times in _FORK_RADII)
        along = np.cumsum(self.skeleton.edge_length[nodes])
        stretch = nodes[(along >= low) & (along <= high)]
        if not len(stretch) or along[-1] < high:
            return 0.0
        return float(np.median(self.skeleton.radius[stretch]) ** 2)

    def over(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far points (n, 3) lie outside the stem, and its node beside each, (n,) both."""
        away, row = self._surface.query(points)
        return away - self._radius[row], self._node[row]

    def _parts_at_the_stem(self, axis: Axis) -> bool:
        """Whether an axis that hangs on a limb is a limb of the same fork and no lateral.

        Its wood comes as near to the stem as where limbs are measured, and the limb does not lead
        it.
        """
        own = self._section_beyond(axis.nodes, axis.attach)
        over, _ = self.over(self.skeleton.points[[axis.attach]])
        if over[0] - np.sqrt(own) > BEYOND_M:
            return False
        bearer = self.axes[axis.parent].nodes
        further = bearer[np.flatnonzero(bearer == axis.attach)[0] + 1 :]
        return self._section_beyond(further, axis.attach) <= _LEADS * own

    def _limb(self, index: int, least: float, kept: np.ndarray) -> Limb | None:
        """The limb that an axis is, None where it stays at the stem or was mostly not seen."""
        way, fields = self.axes[index].way, self.skeleton.fields
        way = way[kept[way]]
        # Its first nodes may have the stem's points: a bridge into empty air has no more than those
        is_seen = fields.get("n_points", np.ones(len(kept))) > 0
        if len(way) < 2 or not np.median(is_seen[way[1:]]):
            return None
        line = Line(self.skeleton.points[way])
        along = np.arange(0.0, line.along[-1], STEP_M)
        over, beside = self.over(line.at(along))
        clear = np.flatnonzero(over >= least)
        if not len(clear):
            return None
        inside = np.flatnonzero(over[: clear[0]] <= 0.0)
        leaves = int(inside[-1]) if len(inside) else 0
        at = along[leaves] + BEYOND_M
        own, place = way[1:], line.along[1:]  # its first node is the stem's
        diameter = 2.0 * float(np.interp(at, place, self.skeleton.radius[own]))
        far = at + max(LEAST_WINDOW_M, 2.0 * diameter)
        stretch = own[(place >= at) & (place <= far)]
        stretch = stretch if len(stretch) else own[-1:]
        error, scatter = (
            float(np.median(fields[name][stretch])) if name in fields else 0.0
            for name in ("radius_error", "residual")
        )
        typical = typical_scatter(self.skeleton) or 0.0
        return Limb(index, int(beside[leaves]), line.at(at), diameter, error, scatter or typical)

    @property
    def crown_start(self) -> int:
        """Node of the stem from which the crown begins, -1 where nothing leaves the stem.

        There its lowest limb comes out of it; without limbs, as on a young tree, its lowest side
        axis.
        """
        if self.limbs:
            return min(limb.stem_node for limb in self.limbs)  # parents come before children
        trunk = set(self._nodes_of(self.stem).tolist())
        sides = (axis for index, axis in enumerate(self.axes) if index not in self.stem)
        return min((axis.attach for axis in sides if axis.attach in trunk), default=-1)

    def clear_stem(self) -> np.ndarray:
        """Nodes below the crown, (n_nodes,) bool: the stem up to its lowest limb, and stubs on it.

        All nodes where nothing leaves the stem. What of a limb lies within the stem's surface is
        the stem's.
        """
        base = self.crown_start
        is_clear = np.full(len(self.skeleton), base < 0)
        trunk = self._nodes_of(self.stem)
        is_clear[trunk[trunk <= base]] = True
        goes_up = {*self.stem, *(limb.axis for limb in self.limbs)}
        for index, axis in enumerate(self.axes):
            if self.limbs and index not in goes_up and is_clear[axis.attach]:
                is_clear[axis.nodes] = True
        over, beside = self.over(self.skeleton.points)
        return is_clear | ((over <= 0.0) & (beside <= base))
