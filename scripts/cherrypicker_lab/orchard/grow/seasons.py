"""A grown tree a year later: limbs that bent, longer tips, new shoots, thicker wood; and pruning.

A node of the tree keeps its number over the dates, so that wood is the same wood. Limbs bend by an
even curvature, the wood that they carry goes along. Wood thickens by a ring, and by the area of the
new tips that it carries (the pipe model of Shinozaki et al., 1964).
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cherrypicker_lab.orchard.grow.growth import curve
from cherrypicker_lab.orchard.grow.tree import Axis, Tree, aside, borne_by, without

NEW = -1  # number of a node that was not there at the first date
LEAST_CUT_NODES = 5  # what a cut takes at least of its axis
CHILD_SHARE = 0.95  # a child is at most so thick, of its parent where it starts


class Season:
    """Ranges (low, high) of what a year does to a tree; guesses for cherry trees."""

    bend_deg: tuple = (5.0, 5.0, 5.0)  # spread of a limb's turn from base to tip, by order from 1
    sag_deg: float = 3.0  # by which limbs of order 1 come down on average
    leader_m: tuple = (0.15, 0.45)  # by which the tips of orders 0 and 1 grow
    lateral_m: tuple = (0.01, 0.15)  # those of the others
    rests: float = 0.4  # share of the tips of higher orders that do not grow
    shoots_a_metre: float = 0.7  # new shoots, on wood of order 1 and higher
    shoot_m: tuple = (0.05, 0.35)
    ring_m: tuple = (0.0002, 0.0006)  # what the radius of all old wood gains at least
    trunk_growth: tuple = (0.04, 0.09)  # of the stem's radius
    tip_radius_m: float = 0.0022


class Pruning:
    """What is cut in a winter."""

    n_limbs: int = 8
    least_length_m: float = 0.25
    least_radius_m: float = 0.004
    headed: float = 0.25  # share of the cuts that shorten a limb instead of taking it out
    stub_m: tuple = (0.003, 0.02)  # that stands out of the wood that bore the limb
    most: float = 0.15  # share of the tree's length that one cut takes at most


@dataclass
class DatedTree:
    """A tree at a date: a number for every node of its axes, `NEW` where it had none."""

    tree: Tree
    numbers: list  # of ndarray of shape (n,), int64, an axis each
    cuts: list = field(default_factory=list)  # dicts: place, diameter_m, length_m, volume_m3

    @property
    def node_numbers(self):
        """Numbers of the nodes of ``tree.skeleton()``, in its order."""
        return self.tree.at_nodes(self.numbers)


def first_date(tree):
    """Number the nodes of a tree."""
    ends = np.cumsum([len(axis.points) for axis in tree.axes])
    return DatedTree(tree, [np.arange(e - len(a.points), e) for e, a in zip(ends, tree.axes)])


def at_date(tree, season, seed):
    """The tree of a first date after a season; trees of equal seeds prune and grow alike.

    The season is "first" (nothing), "grown" (a year's growth), "pruned", or "both" (a pruning and
    then a year's growth).
    """
    dated = first_date(tree)
    if season in ("pruned", "both"):
        dated = prune(dated, np.random.default_rng([int(seed), 301]))
    if season in ("grown", "both"):
        dated = grow_a_year(dated, np.random.default_rng([int(seed), 302]))
    return dated


def grow_a_year(dated, rng):
    """The tree a year later, by `Season`."""
    axes = _bent(dated.tree.axes, rng)
    numbers = list(dated.numbers)
    n_old = [len(axis.points) for axis in axes]
    for number, axis in enumerate(axes):
        if not axis.is_cut and not (axis.order > 1 and rng.random() < Season.rests):
            low, high = Season.leader_m if axis.order < 2 else Season.lateral_m
            axes[number] = _extended(axis, rng, rng.uniform(low, high))
            added = len(axes[number].points) - n_old[number]
            numbers[number] = np.append(numbers[number], np.full(added, NEW))
    for number in range(len(n_old)):
        for shoot in _shoots(axes[number], number, n_old[number], rng):
            axes.append(shoot)
            numbers.append(np.full(len(shoot.points), NEW))
    _thicken(axes, numbers, rng)
    return DatedTree(replace(dated.tree, axes=axes), numbers, dated.cuts)


def prune(dated, rng):
    """The tree with limbs taken out or shortened by `Pruning`, and what was cut noted.

    Fewer limbs are cut where the tree has no more that can be.
    """
    axes, numbers = list(dated.tree.axes), list(dated.numbers)
    beyond = [{i} | borne_by(axes, {i}) for i in range(len(axes))]
    gone, touched, cuts = set(), set(), []
    for i in rng.permutation(_limbs(axes, beyond)):
        if len(cuts) == Pruning.n_limbs:
            break
        if i in touched or beyond[i] & touched:  # neither below nor beyond another cut
            continue
        axis = axes[i]
        at = 1.2 * axes[axis.parent].radii[axis.parent_node] + rng.uniform(*Pruning.stub_m)
        if rng.random() < Pruning.headed:
            at = max(at, rng.uniform(0.3, 0.7) * axis.arclength[-1])
        node = int(np.searchsorted(axis.arclength, at))
        if node >= len(axis.points) - LEAST_CUT_NODES:
            continue
        dropped = set()
        for j in sorted(beyond[i] - {i}):
            if axes[j].parent in dropped or (axes[j].parent == i and axes[j].parent_node > node):
                dropped.add(j)
        parts = [(axis, node), *((axes[j], 0) for j in dropped)]
        cuts.append(
            {
                "place": axis.points[node].tolist(),
                "diameter_m": 2 * float(axis.radii[node]),
                "length_m": float(sum(a.arclength[-1] - a.arclength[k] for a, k in parts)),
                "volume_m3": float(sum(_volume(a, k) for a, k in parts)),
            }
        )
        touched |= beyond[i]
        gone |= dropped
        axes[i] = replace(axis.part(slice(node + 1)), is_cut=True)
        numbers[i] = numbers[i][: node + 1]
    left = [each for i, each in enumerate(numbers) if i not in gone]
    return DatedTree(replace(dated.tree, axes=without(axes, gone)), left, cuts)


def _limbs(axes, beyond):
    """Axes that may be cut."""
    length = [axis.arclength[-1] for axis in axes]
    end = len(axes[0].points) - 1
    return [
        i
        for i, axis in enumerate(axes)
        if axis.order > 0
        and not axis.is_cut
        and length[i] >= Pruning.least_length_m
        and axis.radii[0] >= Pruning.least_radius_m
        and sum(length[j] for j in beyond[i]) <= Pruning.most * sum(length)
        and not (axis.parent == 0 and axis.parent_node == end)  # a fork at the trunk's end
    ]


def _volume(axis, node):
    """Volume of an axis from one of its nodes on, m3."""
    thick, thin = axis.radii[node:-1], axis.radii[node + 1 :]
    step = np.diff(axis.arclength[node:])
    return np.pi / 3 * (step @ (thick**2 + thick * thin + thin**2))


def _bent(axes, rng):
    """The axes, each turned evenly from base to tip, with all that hangs on it."""
    made, turns = [], []  # per axis the rotation at each of its nodes, (n, 3, 3)
    for axis in axes:
        n = len(axis.points)
        start, whole = axis.points[0], np.eye(3)
        if axis.parent >= 0:
            start = made[axis.parent].points[axis.parent_node]
            whole = turns[axis.parent][axis.parent_node]
        turn = np.zeros(3)
        if axis.order > 0:
            spread = Season.bend_deg[min(axis.order, len(Season.bend_deg)) - 1]
            turn = np.radians(spread) * rng.normal(size=3) / np.sqrt(2.0)
            if axis.order == 1:  # the heading's component across the vertical
                chord = axis.points[-1] - axis.points[0]
                down = np.cross([0.0, 0.0, 1.0], chord)
                turn += np.radians(Season.sag_deg) * down / max(np.linalg.norm(down), 1e-9)
        share = axis.arclength / axis.arclength[-1]
        turned = Rotation.from_rotvec(share[:, None] * turn).as_matrix()
        turned = whole @ turned
        steps = np.diff(axis.points, axis=0)
        middle = 0.5 * (turned[1:] + turned[:-1])
        points = np.empty((n, 3))
        points[0] = start
        points[1:] = start + np.cumsum(np.einsum("nij,nj->ni", middle, steps), axis=0)
        made.append(replace(axis, points=points))
        turns.append(turned)
    return made


def _extended(axis, rng, length):
    """An axis with a year's growth at its tip."""
    more = curve(rng, axis.points[-1], axis.tangents[-1], length, wiggle=0.4, upturn=0.5)[1:]
    radii = np.full(len(more), min(Season.tip_radius_m, axis.radii[-1]))
    section = axis.section
    if section is not None:
        section = np.vstack([section, np.ones((len(more), section.shape[1]))])
    points = np.vstack([axis.points, more])
    return replace(axis, points=points, radii=np.append(axis.radii, radii), section=section)


def _shoots(axis, number, n_old, rng):
    """New axes along old wood."""
    if axis.order == 0 or axis.is_cut:
        return []
    n = rng.poisson(Season.shoots_a_metre * axis.arclength[n_old - 1])
    made = []
    for node in rng.integers(1, max(n_old - 1, 2), n):
        direction, _ = aside(rng, axis.tangents[node], 35.0, 65.0)
        length = axis.radii[node] + rng.uniform(*Season.shoot_m)
        points = curve(rng, axis.points[node], direction, length, wiggle=0.4, upturn=0.8)
        radius = min(Season.tip_radius_m, 0.8 * axis.radii[node])
        made.append(Axis(points, np.full(len(points), radius), axis.order + 1, number, int(node)))
    return made


def _thicken(axes, numbers, rng):
    """Radii a year later, in place: a ring on old wood, and the area of the tips carried."""
    ring = rng.uniform(*Season.ring_m)
    carried = [np.zeros(len(axis.points)) for axis in axes]  # number of growing tips beyond a node
    for i in range(len(axes) - 1, -1, -1):
        if (numbers[i] == NEW).any():
            carried[i] += 1.0
        if i:
            carried[axes[i].parent][: axes[i].parent_node + 1] += carried[i][0]
    foot = axes[0].radii[0]
    wanted = (foot * (1.0 + rng.uniform(*Season.trunk_growth))) ** 2
    area = max(wanted - (foot + ring) ** 2, 0.0) / max(carried[0][0], 1.0)
    for i, axis in enumerate(axes):
        old = np.where(numbers[i] == NEW, 0.0, ring)
        radii = np.sqrt((axis.radii + old) ** 2 + area * np.maximum(carried[i] - 1.0, 0.0))
        if axis.parent >= 0:
            radii = np.minimum(radii, CHILD_SHARE * axes[axis.parent].radii[axis.parent_node])
        axes[i] = replace(axis, radii=radii)
