"""A tree as data: axes that start on their parents, and the exact skeleton that they join to."""

from dataclasses import dataclass, field, replace

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.skeleton.model import Skeleton


@dataclass
class Axis:
    """One axis of a tree."""

    # (n, 3) float64: nodes along the axis, m, tree frame; the first lies on the parent's node
    points: np.ndarray
    radii: np.ndarray  # (n,) float64: radius at each node, m
    order: int  # 0 trunk, 1 scaffold, 2 lateral, 3 twig
    parent: int = -1  # index of the parent axis, -1 for the trunk
    parent_node: int = -1  # node of the parent that the axis starts on
    # ndarray of shape (n, k), float64, optional: wood that is no circle: its surface's distance
    # from the axis at k angles, of `radii`. The mean square of a row is 1, so that `radii` are
    # those of circles of equal area.
    section: np.ndarray | None = None
    is_cut: bool = False  # a stub, whose end is flat
    years: np.ndarray | None = None  # (n,) int64: in which each node grew, of a tree that tells

    @property
    def arclength(self):
        """Arc length at each node, shape (n,), m."""
        steps = np.diff(self.points, axis=0)
        way = np.zeros(len(self.points))
        np.cumsum(np.sqrt((steps * steps).sum(axis=1)), out=way[1:])
        return way

    @property
    def tangents(self):
        """Unit tangents at the nodes, shape (n, 3)."""
        p = self.points
        d = np.empty_like(p)  # np.gradient takes ten times as long on so few nodes
        d[1:-1] = (p[2:] - p[:-2]) / 2.0
        d[0], d[-1] = p[1] - p[0], p[-1] - p[-2]
        return d / np.sqrt((d * d).sum(axis=1))[:, None]

    @property
    def reach(self):
        """Farthest distance of the surface from the axis at each node, shape (n,), m."""
        return self.radii if self.section is None else self.radii * self.section.max(axis=1)

    def at(self, s):
        """Points (n, 3) on the axis and its `reach` (n,) at arc lengths (n,), m."""
        way = self.arclength
        points = np.stack([np.interp(s, way, self.points[:, i]) for i in range(3)], axis=1)
        return points, np.interp(s, way, self.reach)

    def part(self, rows):
        """The axis without the nodes outside a slice."""
        section = None if self.section is None else self.section[rows]
        years = None if self.years is None else self.years[rows]
        return replace(
            self, points=self.points[rows], radii=self.radii[rows], section=section, years=years
        )

    @property
    def label(self):
        """`Label.TRUNK` for order 0, else `Label.BRANCH`."""
        return Label.TRUNK if self.order == 0 else Label.BRANCH


def borne_by(axes, those):
    """Numbers of all axes that grow on some, and on these; parents come before children."""
    found = set()
    for i, axis in enumerate(axes):
        if axis.parent in those or axis.parent in found:
            found.add(i)
    return found


def without(axes, gone):
    """The axes but those of some numbers, with which all that they bear must go."""
    place = {old: new for new, old in enumerate(i for i in range(len(axes)) if i not in gone)}
    place[-1] = -1
    return [replace(a, parent=place[a.parent]) for i, a in enumerate(axes) if i not in gone]


def aside(rng, tangent, low, high):
    """A direction (3,) off a tangent by a random angle (degrees) on any side, and the angle."""
    side = np.cross(tangent, rng.normal(size=3))
    angle = np.radians(rng.uniform(low, high))
    return np.cos(angle) * tangent + np.sin(angle) * side / np.linalg.norm(side), angle


def relative_radius(section, row, share, angle):
    """Distance from the axis, of the radius, between nodes and angles, and its change a radian.

    Both are (m,). `section` (n, k) is as `Axis.section`, its angles even from 0 on. `row` (m,) are
    nodes, `share` (m,) tells how far on the way to the next node, `angle` (m,) is in radians.
    """
    k = section.shape[1]
    at = angle * (k / (2 * np.pi))
    left = np.floor(at).astype(np.int64)
    one, other = (
        (1 - share) * section[row, column % k] + share * section[row + 1, column % k]
        for column in (left, left + 1)
    )
    return one + (at - left) * (other - one), (other - one) * (k / (2 * np.pi))


@dataclass
class Tree:
    """A grown tree: its habit's name, its axes (parents before children) and its bark's seed.

    `paint_m` is the height up to which its stem is painted white, 0 for none, `relief` the depth
    of its bark's relief (see `appearance.bark_relief`), `buds` a `buds.Buds` or None.
    """

    habit: str
    axes: list = field(default_factory=list)
    bark_seed: int = 0
    paint_m: float = 0.0
    relief: float = 0.0
    buds: object = None

    @property
    def bark(self):
        """The material of its wood, see `appearance.surface_color`."""
        return {"kind": "bark", "seed": self.bark_seed, "paint_m": self.paint_m,
                "relief": self.relief}  # fmt: skip

    @property
    def height(self):
        """Height of its highest node, m."""
        return float(max(axis.points[:, 2].max() for axis in self.axes))

    @property
    def labels(self):
        """Class of each of its axes, (n_axes,) uint8."""
        return np.array([int(axis.label) for axis in self.axes], np.uint8)

    def skeleton(self):
        """Join the axes into one rooted `Skeleton` whose junctions share a node, with ``order``."""
        parents, first = [], []
        total = 0
        for axis in self.axes:
            start = 0 if axis.parent < 0 else 1  # a child's first node is its parent's
            first.append(total - start)
            ids = total + np.arange(len(axis.points) - start)
            link = ids - 1
            link[0] = -1 if axis.parent < 0 else first[axis.parent] + axis.parent_node
            parents.append(link)
            total += len(ids)

        n = [len(a.points) for a in self.axes]
        return Skeleton(
            self.at_nodes([a.points for a in self.axes]),
            np.concatenate(parents),
            self.at_nodes([a.radii for a in self.axes]),
            self.at_nodes([np.full(k, int(a.label)) for k, a in zip(n, self.axes)]),
            {"order": self.at_nodes([np.full(k, a.order) for k, a in zip(n, self.axes)])},
        )

    def at_nodes(self, values):
        """What the axes have at their nodes, an array each, by the nodes of `skeleton`."""
        return np.concatenate([v if a.parent < 0 else v[1:] for v, a in zip(values, self.axes)])
