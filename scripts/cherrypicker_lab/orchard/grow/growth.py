"""Leafless sweet cherry trees grown from a seed: axes, radii, orders and the exact skeleton.

A tree is a list of axes. An axis is a smooth tapered curve that starts on a node of its parent;
orders are trunk (0), scaffold (1), lateral (2) and twig (3). Three trained forms are grown:
the central leader, the spindle (many short flat scaffolds) and the open vase.
"""

from dataclasses import dataclass, replace

import numpy as np

from cherrypicker_lab.orchard.grow.tree import Axis, Tree

NODE_STEP_M = 0.01
TRUNK_RATIO = 0.8
HIGHEST_FORK = 0.5  # of the height


@dataclass(frozen=True)
class Habit:
    """Ranges (low, high) from which a tree of this form is drawn. Lengths m, angles degrees."""

    name: str
    height: tuple = (2.0, 3.0)
    trunk_radius: tuple = (0.030, 0.055)
    first_scaffold: tuple = (0.45, 0.70)
    n_scaffolds: tuple = (9, 14)
    scaffold_angle: tuple = (50.0, 70.0)
    scaffold_length: tuple = (0.34, 0.42)
    scaffold_upturn: tuple = (0.35, 0.8)
    lateral_spacing: tuple = (0.15, 0.22)
    twig_spacing: tuple = (0.10, 0.16)
    forked: bool = False


HABITS = {
    "leader": Habit("leader"),
    "spindle": Habit(
        "spindle",
        n_scaffolds=(14, 20),
        scaffold_angle=(68.0, 88.0),
        scaffold_length=(0.24, 0.32),
        scaffold_upturn=(0.1, 0.45),
    ),
    "vase": Habit(
        "vase",
        height=(2.0, 2.8),
        trunk_radius=(0.036, 0.060),
        first_scaffold=(0.55, 0.85),
        n_scaffolds=(3, 5),
        scaffold_angle=(32.0, 48.0),
        scaffold_upturn=(0.5, 1.0),
        lateral_spacing=(0.14, 0.20),
        forked=True,
    ),
}


def _unit(v):
    return v / np.linalg.norm(v)


def curve(rng, start, direction, length, *, wiggle, upturn):
    """Integrate a smooth random curve; `upturn` (1/m) bends it towards the sky."""
    n = max(int(round(length / NODE_STEP_M)), 3)
    step = length / n
    d = _unit(np.asarray(direction, dtype=float))
    bend = rng.normal(size=3)
    points = np.empty((n + 1, 3))
    points[0] = start
    for i in range(n):
        # the bend is an AR(1) process with a memory of about 12 cm
        bend += -bend * step / 0.12 + rng.normal(size=3) * np.sqrt(2 * step / 0.12)
        d = _unit(d + step * (wiggle * bend + upturn * np.array([0.0, 0.0, 1.0])))
        points[i + 1] = points[i] + step * d
    return points


def _taper(arclength, base, tip, *, power=0.85, collar=0.0, collar_length=0.02):
    """Radii falling from `base` to `tip`, thicker by `collar` where the axis leaves its parent."""
    t = arclength / arclength[-1]
    radii = tip + (base - tip) * (1.0 - t) ** power
    return radii + collar * np.exp(-((arclength / collar_length) ** 2))


def _child(rng, tree, parent, node, *, azimuth, angle_deg, length, base, tip, wiggle, upturn):
    """Append an axis that leaves `parent` at `node`; its radius stays below the parent's."""
    mother = tree.axes[parent]
    tangent, thick = mother.tangents[node], mother.radii[node]
    angle = np.radians(angle_deg)
    ref = np.array([1.0, 0.0, 0.0]) if abs(tangent[2]) > 0.7 else np.array([0.0, 0.0, 1.0])
    u = _unit(np.cross(tangent, ref))
    side = np.cos(azimuth) * u + np.sin(azimuth) * np.cross(tangent, u)
    direction = np.cos(angle) * tangent + np.sin(angle) * side
    points = curve(rng, mother.points[node], direction, length, wiggle=wiggle, upturn=upturn)
    base = min(base, 0.72 * thick)
    tip = min(tip, 0.9 * base)
    axis = Axis(points, np.empty(len(points)), mother.order + 1, parent, node)
    collar = min(0.35 * base, 0.9 * thick - base)
    axis.radii = _taper(axis.arclength, base, tip, collar=collar, collar_length=1.2 * thick)
    tree.axes.append(axis)
    return len(tree.axes) - 1


def _ramify(rng, tree, parent, *, spacing, start, kind, density):
    """Set the next order's axes along one axis, alternating around it."""
    mother = tree.axes[parent]
    s, total = mother.arclength, mother.arclength[-1]
    azimuth = rng.uniform(0, 2 * np.pi)
    at = start + rng.uniform(0, spacing)
    made = []
    while at < total - 0.03:
        node = int(np.searchsorted(s, at))
        left = total - at
        azimuth += np.pi * rng.uniform(0.65, 1.1)
        if kind == "lateral":
            length = (0.10 + rng.uniform(0.25, 0.5) * left) * rng.uniform(0.8, 1.15)
            base, tip = 0.0038 + 0.0095 * length, 0.0026
        else:
            length = rng.uniform(0.05, 0.16) if rng.random() < 0.75 else rng.uniform(0.02, 0.04)
            base, tip = 0.0024 + 0.007 * length, 0.0021
        if mother.radii[node] > 0.003:
            made.append(
                _child(
                    rng,
                    tree,
                    parent,
                    node,
                    azimuth=azimuth,
                    angle_deg=rng.uniform(38, 65),
                    length=length,
                    base=base,
                    tip=tip,
                    wiggle=0.45,
                    upturn=rng.uniform(0.3, 1.3),
                )
            )
        at += spacing * rng.uniform(0.65, 1.35) / density
    return made


def _grow_trunk(rng, habit, height, radius, fork):
    """The trunk: to the top for a leader, to the main fork for a vase."""
    length = fork if habit.forked else height
    lean = np.append(rng.normal(size=2) * 0.02, 1.0)
    points = curve(rng, np.zeros(3), lean, length, wiggle=0.10, upturn=0.12)
    axis = Axis(points, np.empty(len(points)), 0)
    s = axis.arclength
    if habit.forked:
        axis.radii = radius * (1.0 - 0.12 * s / s[-1])
    else:
        axis.radii = _taper(s, radius, 0.0035, power=rng.uniform(0.75, 0.95))
    axis.radii = axis.radii + 0.3 * radius * np.exp(-s / 0.05)  # root flare
    return axis


def _grow_scaffolds(rng, tree, habit, height, fork):
    """First-order axes: up the leader in a spiral, or all from the vase's fork."""
    n = int(rng.integers(habit.n_scaffolds[0], habit.n_scaffolds[1] + 1))
    trunk = tree.axes[0]
    s = trunk.arclength
    azimuth = rng.uniform(0, 2 * np.pi)
    longest = rng.uniform(*habit.scaffold_length) * height
    made = []
    for i in range(n):
        if habit.forked:
            node = len(s) - 1
            azimuth += 2 * np.pi / n * rng.uniform(0.85, 1.15)
            angle = rng.uniform(*habit.scaffold_angle)
            length = (height - fork) / np.cos(np.radians(0.75 * angle)) * rng.uniform(0.85, 1.05)
            base = trunk.radii[-1] * rng.uniform(0.50, 0.66)
        else:
            t = (i + rng.uniform(-0.3, 0.3)) / n
            at = np.clip(fork + (0.92 * height - fork) * t, 0.3, 0.92 * height)
            node = int(np.searchsorted(s, at))
            azimuth += np.radians(137.5 + rng.normal() * 12)
            angle = rng.uniform(*habit.scaffold_angle) - 12 * t
            length = longest * (1.0 - 0.72 * max(t, 0.0)) * rng.uniform(0.8, 1.15)
            base = min(0.0065 + 0.0125 * length, 0.55 * trunk.radii[node])
        made.append(
            _child(
                rng,
                tree,
                0,
                node,
                azimuth=azimuth,
                angle_deg=angle,
                length=length,
                base=base,
                tip=0.0032,
                wiggle=0.35,
                upturn=rng.uniform(*habit.scaffold_upturn),
            )
        )
    return made


def trunk_end_node(axis, fork_nodes, fork_axes):
    """Node of the stem where the trunk ends by the rule of the labels.

    At `fork_nodes` of the stem `fork_axes` start, in the same order. The trunk ends at the first
    fork above which even the thickest axis keeps less than 0.8 of the radius one stem diameter
    below the fork, both measured one stem diameter from it; at the last node of the stem if there
    is none.
    """
    s = axis.arclength
    for node, _ in sorted(zip(fork_nodes, range(len(fork_nodes)))):
        diameter = 2 * axis.radii[node]
        below = np.interp(max(s[node] - diameter, 0.0), s, axis.radii)
        above = 0.0
        if s[-1] > s[node]:
            above = np.interp(s[node] + diameter, s, axis.radii)
        for other_node, other in zip(fork_nodes, fork_axes):
            if other_node == node:
                above = max(above, np.interp(diameter, other.arclength, other.radii))
        if above < TRUNK_RATIO * below:
            return node
    return len(s) - 1


def end_trunk_by_rule(tree):
    """Cut the stem of a tree, in place, where the rule ends the trunk; the rest has order 1."""
    stem = tree.axes[0]
    children = [i for i, a in enumerate(tree.axes) if a.parent == 0]
    nodes = [tree.axes[i].parent_node for i in children]
    end = trunk_end_node(stem, nodes, [tree.axes[i] for i in children])
    if end >= len(stem.points) - 1:
        return
    upper = replace(stem.part(slice(end, None)), order=1, parent=0, parent_node=end)
    tree.axes[0] = stem.part(slice(end + 1))
    shift = {0: 0, **{i: i + 1 for i in range(1, len(tree.axes))}}
    moved = set()
    for i, axis in enumerate(tree.axes[1:], start=1):
        if axis.parent == 0 and axis.parent_node > end:
            moved.add(i)
            axis.parent, axis.parent_node = 1, axis.parent_node - end
            axis.order += 1
        else:
            if axis.parent in moved:
                moved.add(i)
                axis.order = min(axis.order + 1, 4)
            axis.parent = shift[axis.parent]
    tree.axes.insert(1, upper)


def grow_tree(seed, habit="leader", *, height=None, trunk_radius=None, density=1.0):
    """Grow one leafless cherry tree, z up, its foot at the origin.

    Equal arguments give an equal tree. Its form is a key of `HABITS` or a `Habit`. The height of
    the leader or of the vase's scaffolds and the stem's radius above the root flare, both m, are
    drawn from the habit by default. `density` says how closely laterals and twigs stand, relative
    to the habit. Raises a ValueError if the habit is not known.
    """
    if isinstance(habit, str):
        if habit not in HABITS:
            raise ValueError(f"habit must be one of {sorted(HABITS)}, got {habit!r}")
        habit = HABITS[habit]
    rng = np.random.default_rng([int(seed), 11])
    drawn_height, drawn_radius = rng.uniform(*habit.height), rng.uniform(*habit.trunk_radius)
    height = drawn_height if height is None else float(height)
    radius = drawn_radius if trunk_radius is None else float(trunk_radius)
    # the habit's heights are a grown tree's: a small one forks lower
    fork = min(rng.uniform(*habit.first_scaffold), HIGHEST_FORK * height)
    tree = Tree(habit.name, [_grow_trunk(rng, habit, height, radius, fork)], int(seed))
    spacing2, spacing3 = rng.uniform(*habit.lateral_spacing), rng.uniform(*habit.twig_spacing)
    for scaffold in _grow_scaffolds(rng, tree, habit, height, fork):
        laterals = _ramify(
            rng, tree, scaffold, spacing=spacing2, start=0.10, kind="lateral", density=density
        )
        _ramify(rng, tree, scaffold, spacing=2 * spacing3, start=0.08, kind="twig", density=density)
        for lateral in laterals:
            _ramify(rng, tree, lateral, spacing=spacing3, start=0.06, kind="twig", density=density)
    end_trunk_by_rule(tree)
    return tree
