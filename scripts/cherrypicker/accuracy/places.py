"""Which branch a hand measurement was taken on, and how thick the skeleton is there.

A place is a point on the bark in the cloud's frame, or where the calliper was put as told from the
stem: height over its foot, azimuth and, where it was measured, distance.

- A point belongs to the branch whose surface is nearest to it, inside or outside.
- What is told from the stem is known to some centimetres alone: a level half-line from the stem's
  axis outwards, or a place on it. Of the branches whose surface comes within the tolerance to it,
  it means those of the lowest order, of these the nearest.

A branch's order, where it was noted, leaves no other.

The diameter is the skeleton's at the foot of the perpendicular, between its nodes linear.
"""

from dataclasses import dataclass, replace

import numpy as np

from cherrypicker.geometry.lines import NEAR
from cherrypicker.skeleton import Axis, Skeleton, axis_of_node

#: Farthest that a branch's surface may lie from a place, m: what an azimuth told to 5 degrees and a
#: height told to a decimetre leave open on a limb 1 m from the stem (a guess).
TOLERANCE_M = 0.10


@dataclass(frozen=True)
class Place:
    """Where a measurement lies on the skeleton."""

    branch: int  # number of the axis
    diameter: float
    node: int  # outer end of the edge that it lies on
    rivals: tuple[int, ...] = ()  # branches of the same order that the place may mean as well
    stretch: float = 0.0  # how much of the branch a half-line runs through, m


class Places:
    """A skeleton that places are looked up on."""

    def __init__(self, skeleton: Skeleton, axis_list: list[Axis], foot_z: float) -> None:
        self.foot_z, trunk = foot_z, axis_list[0].nodes
        self.stem, self.stem_radius = skeleton.points[trunk], np.median(skeleton.radius[trunk])
        self.order = np.array([axis.order for axis in axis_list])
        owner, parent = axis_of_node(skeleton, axis_list), skeleton.parent
        inner = parent[1:]
        self.branch = owner[1:]
        self.start = skeleton.points[inner]
        self.step = skeleton.points[1:] - self.start
        # Where a branch begins its parent's radius is not its own
        is_first = owner[inner] != self.branch
        self.radius_start = np.where(is_first, skeleton.radius[1:], skeleton.radius[inner])
        self.radius_step = skeleton.radius[1:] - self.radius_start

    def at_point(self, point: np.ndarray, order: int | None = None) -> Place | None:
        """Return the place nearest to a point, (3,), on a branch of an order where that is known.

        None beyond the tolerance.
        """
        share, gap = self._from_point(point)
        gap[~self._is_of(order)] = np.inf
        edge = np.argmin(gap)
        return self._place(edge, share) if gap[edge] <= TOLERANCE_M else None

    def towards(
        self,
        height: float,
        azimuth_deg: float,
        distance: float | None = None,
        order: int | None = None,
    ) -> Place | None:
        """Return the place in a direction from the stem; None beyond the tolerance.

        It is `height` m over the stem's foot, by the azimuth from +x towards +y, and level
        `distance` m from the stem's axis, or anywhere on the half-line without it. The order is
        as of `at_point`.
        """
        z, angle = self.foot_z + height, np.radians(azimuth_deg)
        # On the trunk's axis (above its end, over the end)
        x, y, _ = self.stem[np.argmin(np.abs(self.stem[:, 2] - z))]
        origin, outwards = np.array([x, y, z]), np.array([np.cos(angle), np.sin(angle), 0.0])
        share = self._level_share(z)
        offset = self.start + share[:, None] * self.step - origin
        along = offset @ outwards
        gap = np.linalg.norm(offset - along[:, None] * outwards, axis=1) - self._radius(share)
        touched = gap <= 0
        if distance is not None:
            share, gap = self._from_point(origin + distance * outwards)
        is_meant = self._is_of(order) & (along > self.stem_radius) & (gap <= TOLERANCE_M)
        near = np.flatnonzero(is_meant & (self.order[self.branch] > 0))
        if not len(near):
            return None
        orders = self.order[self.branch[near]]
        near = near[orders == orders.min()]
        edge = near[np.argmin(gap[near])]
        if distance is not None:
            return self._place(edge, share)
        rivals = set(self.branch[near].tolist()) - {int(self.branch[edge])}
        touched &= self.branch == self.branch[edge]
        stretch = float(np.ptp(along[touched])) if touched.any() else 0.0
        return replace(self._place(edge, share), rivals=tuple(sorted(rivals)), stretch=stretch)

    def on_trunk(self, height: float) -> Place | None:
        """Return the place on the trunk at a height over its foot; None where it ends below."""
        share = self._level_share(self.foot_z + height)
        rise = np.abs(self.start[:, 2] + share * self.step[:, 2] - self.foot_z - height)
        rise[self.order[self.branch] > 0] = np.inf
        edge = np.argmin(rise)
        return self._place(edge, share) if rise[edge] <= NEAR else None

    def _is_of(self, order: int | None) -> np.ndarray:
        order_of_edge = self.order[self.branch]
        return np.ones(len(order_of_edge), bool) if order is None else order_of_edge == order

    def _from_point(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where each edge is nearest to a point, and how far its surface is, (n_edges,) each."""
        square = np.maximum(np.einsum("ij,ij->i", self.step, self.step), 1e-18)
        share = np.einsum("ij,ij->i", point - self.start, self.step) / square
        share = np.clip(share, 0.0, 1.0)
        offset = point - self.start - share[:, None] * self.step
        return share, np.linalg.norm(offset, axis=1) - self._radius(share)

    def _level_share(self, z: float) -> np.ndarray:
        """How far along each edge it is nearest to a height, (n_edges,) in [0, 1]."""
        rise = np.where(np.abs(self.step[:, 2]) < 1e-9, 1e-9, self.step[:, 2])
        return np.clip((z - self.start[:, 2]) / rise, 0.0, 1.0)

    def _radius(self, share: np.ndarray) -> np.ndarray:
        return self.radius_start + share * self.radius_step

    def _place(self, edge: np.integer, share: np.ndarray) -> Place:
        diameter = 2.0 * float(self._radius(share)[edge])
        return Place(int(self.branch[edge]), diameter, int(edge) + 1)
