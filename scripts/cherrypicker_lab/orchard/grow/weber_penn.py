"""Trees by the growth model of Weber and Penn, in the data model of `growth`.

Source: J. Weber and J. Penn, "Creation and Rendering of Realistic Trees", SIGGRAPH 1995, the model
behind Blender's Sapling. The names of the parameters are the paper's. What differs from it:

- An axis is integrated every centimetre with a constant turn within a curve segment, so that it is
  smooth; the paper's segments are straight.
- A clone that splits off a stem is an axis of the next order and starts at `SPLIT_KEEPS` of the
  stem's radius: the stem that it leaves stays the thicker one, so that the order of an axis is one
  thing for the generator and for whoever measures the skeleton.
- A child starts at most at `CHILD_KEEPS` of its parent's radius, and no axis tapers below the tip
  radius that is drawn for it; where the parent is too thin for that, no child grows.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from cherrypicker_lab.orchard.grow.ageing import Ageing, age_tree
from cherrypicker_lab.orchard.grow.growth import NODE_STEP_M, end_trunk_by_rule
from cherrypicker_lab.orchard.grow.tree import Axis, Tree

CHILD_KEEPS = 0.78
SPLIT_KEEPS = 0.82
FORK_KEEPS = 0.70
FORK_TAPER = 0.12  # of a trunk that ends in a fork, not in a tip
TIP_ROOM = 1.08  # a base is at least so much wider than the narrowest tip
LEAST_LENGTH_M = 0.03


@dataclass(frozen=True)
class Level:
    """Parameters of the stems of one level; angles in degrees, `_v` is a spread around a mean."""

    branches: float = 0.0  # most children that a stem of the level below bears
    # length, length_v: longest length as a share of the parent's (of the tree's height for the
    # trunk)
    length: float = 1.0
    length_v: float = 0.0
    # down_angle, down_angle_v: angle with the parent. A negative spread changes the angle along the
    # parent instead: by so much more at its base than at the middle of the shape.
    down_angle: float = 60.0
    down_angle_v: float = 10.0
    # rotate, rotate_v: azimuth from one child to the next; a negative angle alternates sides
    rotate: float = 140.0
    rotate_v: float = 20.0
    # curve, curve_back, curve_v, bend_v: turn from base to tip (its second half: `curve_back`,
    # where it is not 0), random turn in the plane of the curve and out of it
    curve: float = 0.0
    curve_back: float = 0.0
    curve_v: float = 0.0
    bend_v: float = 0.0
    curve_res: int = 5  # segments of constant turn
    # seg_splits, split_angle, split_angle_v: mean number of clones a segment, and their angle with
    # the stem
    seg_splits: float = 0.0
    split_angle: float = 0.0
    split_angle_v: float = 0.0
    whorl: int = 1  # children that start at one height; 1 spreads them evenly


@dataclass(frozen=True)
class Parameters:
    """A template: what the paper calls a tree's parameters. Ranges are (low, high)."""

    name: str
    levels: tuple  # trunk, scaffolds, laterals, twigs; at most four
    height: tuple = (2.0, 4.0)  # height of the trunk's axis, m
    ratio: tuple = (0.015, 0.025)  # trunk radius per height
    ratio_power: float = 1.2  # how the radius of a child follows its length
    shape: int = 0  # envelope of the crown, see `shape_ratio`
    base_size: tuple = (0.15, 0.25)  # share of the trunk without branches
    flare: float = 0.4  # how much the root flare widens the trunk's foot
    # Clones that the trunk divides into at its base size; it ends there. (0, 0): it does not.
    base_splits: tuple = (0, 0)
    # Turn towards the sky over a stem's length, in units of its declination; negative: down
    attraction_up: float = 0.0
    tip_radius: tuple = (0.002, 0.003)  # radius of the tips, m
    ageing: Ageing | None = None  # of an old tree, see `ageing`


def shape_ratio(shape, ratio):
    """Length of a branch relative to the longest, by where it starts (the paper's table 1).

    Shapes are 0 (conical), 3 (cylindrical) and 4 (tapered cylindrical); no template has the other
    five. The ratio is 1 at the crown's base, 0 at its top.
    """
    r = min(max(float(ratio), 0.0), 1.0)
    return {0: 0.2 + 0.8 * r, 3: 1.0, 4: 0.5 + 0.5 * r}[shape]


@njit(cache=True)
def _turned(frame, axis, angle):
    """A frame (columns x, y, z) turned about its own axis 0 or 1 by an angle, by Rodrigues."""
    a, b = (1, 2) if axis == 0 else (2, 0)
    c, s = np.cos(angle), np.sin(angle)
    out = frame.copy()
    for k in range(3):
        out[k, a] = c * frame[k, a] + s * frame[k, b]
        out[k, b] = c * frame[k, b] - s * frame[k, a]
    return out


@njit(cache=True)
def _integrate(start, frame, step, pitch, yaw, attraction):
    """Walk a turtle whose heading is the frame's z column; positions and frames at all nodes.

    `pitch` turns about x, `yaw` about y (radians a step), `attraction` is the share of the
    declination that a step takes away.
    """
    n = len(pitch)
    points, frames = np.empty((n + 1, 3)), np.empty((n + 1, 3, 3))
    points[0], frames[0] = start, frame
    for i in range(n):
        frame = _turned(_turned(frame, 0, -pitch[i]), 1, yaw[i])
        if attraction != 0.0:
            declination = np.arccos(min(max(frame[2, 2], -1.0), 1.0))
            # about the frame's x and y: only what they can turn towards the sky
            frame = _turned(frame, 0, attraction * declination * frame[2, 1])
            frame = _turned(frame, 1, attraction * declination * frame[2, 0])
        for k in range(3):
            points[i + 1, k] = points[i, k] + step * frame[k, 2]
        frames[i + 1] = frame
    return points, frames


def _rotated(frame, azimuth, down):
    """Frame of a child: the parent's turned about its heading, then tipped away from it."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    about = frame @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return _turned(np.ascontiguousarray(about), 0, -down)


@dataclass
class _Stem:
    """A stem that has grown: its place in the tree and what its children need to know."""

    index: int
    level: int
    length: float
    base_radius: float
    frames: np.ndarray
    relative: float = 1.0
    bare: float = 0.0


class _Grower:
    """One tree on its way; holds the generator, the template and the axes so far."""

    def __init__(self, parameters, rng, seed, density):
        self.p, self.rng, self.density = parameters, rng, density
        self.tree = Tree(parameters.name, [], int(seed))
        self.waiting = []

    def spread(self, mean, variation):
        """Mean with a uniform spread."""
        return mean + variation * self.rng.uniform(-1.0, 1.0)

    def stem(self, level, start, frame, length, base, *, parent=-1, node=-1, relative=1.0,
             bare=0.0, taper=1.0, splits=True):  # fmt: skip
        """Grow one axis with its splits, and queue what it bears."""
        p, rng, kind = self.p, self.rng, self.p.levels[level]
        n = max(int(round(length / NODE_STEP_M)), 3)
        segment = np.minimum(np.arange(n) * kind.curve_res // n, kind.curve_res - 1)
        pitch = np.full(n, np.radians(kind.curve) / n)
        if kind.curve_back != 0.0:
            half = np.arange(n) < n // 2
            pitch = np.radians(np.where(half, kind.curve, kind.curve_back)) / (0.5 * n)
        turns = rng.uniform(-1.0, 1.0, (2, kind.curve_res)) / n
        pitch = pitch + np.radians(kind.curve_v) * turns[0][segment]
        yaw = np.radians(kind.bend_v) * turns[1][segment]
        up = self.p.attraction_up / n if level > 0 else 0.0
        points, frames = _integrate(
            np.asarray(start, float), np.ascontiguousarray(frame), length / n, pitch, yaw, up
        )
        tip = min(rng.uniform(*p.tip_radius), 0.95 * base)
        along = np.linspace(0.0, 1.0, n + 1)
        radii = np.maximum(base * (1.0 - taper * along), tip)
        if level == 0 and parent < 0:
            # the paper's flare, a hundredfold decay over the lowest eighth
            radii = radii + base * p.flare * np.maximum(100.0 ** (1.0 - 8.0 * along) - 1, 0) / 100
        order = 0 if parent < 0 else self.tree.axes[parent].order + 1
        self.tree.axes.append(Axis(points, radii, order, parent, node))
        made = _Stem(len(self.tree.axes) - 1, level, length, base, frames, relative, bare)
        self.waiting.append(made)
        if splits and kind.seg_splits > 0 and level > 0:
            self.split(made, along)
        return made

    def split(self, stem, along):
        """Clones that leave a stem at the ends of its segments and run to its length."""
        kind, axis = self.p.levels[stem.level], self.tree.axes[stem.index]
        carried = self.rng.uniform(0.0, 1.0)
        for k in range(1, kind.curve_res):
            carried += kind.seg_splits * self.density
            n_clones, carried = int(carried), carried - int(carried)
            node = int(round(k / kind.curve_res * (len(along) - 1)))
            for _ in range(n_clones):
                base = SPLIT_KEEPS * axis.radii[node]
                left = stem.length * (1.0 - along[node])
                if base < TIP_ROOM * self.p.tip_radius[0] or left < LEAST_LENGTH_M:
                    continue
                angle = np.radians(self.spread(kind.split_angle, kind.split_angle_v))
                azimuth = self.rng.uniform(0, 2 * np.pi)
                frame = _rotated(stem.frames[node], azimuth, angle)
                # a clone that split again would make the stems run away
                self.stem(
                    stem.level, axis.points[node], frame, left, base, parent=stem.index,
                    node=node, relative=stem.relative * left / stem.length, splits=False,
                )  # fmt: skip

    def offsets(self, stem, kind):
        """Where along a stem its children start, as shares of its length, base to tip."""
        first = stem.bare
        share = 0.2 + 0.8 * stem.relative if stem.level == 1 else 1.0 if stem.level == 0 else 0.5
        n = kind.branches * share * (1.0 - first) * self.density
        n = int(n + self.rng.random())
        if n == 0:
            return np.empty(0)
        n_whorls = max(int(round(n / kind.whorl)), 1)
        at = (np.arange(n_whorls) + self.rng.uniform(0.2, 0.8, n_whorls)) / n_whorls
        at = np.repeat(at, kind.whorl)[: max(n, 1)]
        return first + (0.97 - first) * at

    def bear(self, stem):
        """The next level's stems along one stem."""
        p, rng = self.p, self.rng
        if stem.level + 1 >= len(p.levels):
            return
        kind, axis = p.levels[stem.level + 1], self.tree.axes[stem.index]
        longest = self.spread(kind.length, kind.length_v)
        azimuth, side = rng.uniform(0, 2 * np.pi), 1.0
        for t in self.offsets(stem, kind):
            node = int(round(t * (len(axis.points) - 1)))
            if kind.rotate >= 0:
                azimuth += np.radians(self.spread(kind.rotate, kind.rotate_v))
                turn = azimuth
            else:
                side = -side
                turn = side * np.radians(self.spread(-kind.rotate, kind.rotate_v)) / 2
            height = (1.0 - t) / max(1.0 - stem.bare, 1e-6)
            shape = shape_ratio(p.shape, height)
            if stem.level == 0:
                length = longest * stem.length * shape
            else:
                length = longest * stem.length * (1.0 - 0.6 * t)
            length *= rng.uniform(0.85, 1.15)
            thick = axis.radii[node]
            base = stem.base_radius * (length / stem.length) ** p.ratio_power
            base = min(base, CHILD_KEEPS * thick)
            base = max(base, TIP_ROOM * p.tip_radius[0])
            if base > CHILD_KEEPS * thick or length < LEAST_LENGTH_M:
                continue
            if kind.down_angle_v < 0:
                down = kind.down_angle + kind.down_angle_v * (1 - 2 * shape_ratio(0, height))
                down += rng.uniform(-6.0, 6.0)
            else:
                down = self.spread(kind.down_angle, kind.down_angle_v)
            frame = _rotated(stem.frames[node], turn, np.radians(down))
            relative = length / (longest * stem.length)
            self.stem(
                stem.level + 1, axis.points[node], frame, length, base, parent=stem.index,
                node=node, relative=min(relative, 1.0), bare=0.06,
            )  # fmt: skip

    def fork(self, trunk, height, n):
        """The trunk divides into n equal clones, which carry the crown."""
        axis, kind = self.tree.axes[0], self.p.levels[0]
        azimuth = self.rng.uniform(0, 2 * np.pi)
        self.waiting.remove(trunk)
        for _ in range(n):
            azimuth += 2 * np.pi / n * self.rng.uniform(0.85, 1.15)
            angle = np.radians(self.spread(kind.split_angle, kind.split_angle_v))
            frame = _rotated(trunk.frames[-1], azimuth, angle)
            left = (height - trunk.length) / np.cos(0.75 * angle) * self.rng.uniform(0.85, 1.05)
            base = FORK_KEEPS * axis.radii[-1] * self.rng.uniform(0.8, 1.0)
            self.stem(
                1, axis.points[-1], frame, left, base, parent=0, node=len(axis.points) - 1,
                relative=1.0, bare=0.12,
            )  # fmt: skip


def grow_weber_penn(seed, parameters, *, height=None, trunk_radius=None, density=1.0):
    """Grow one leafless tree of a template (`templates`); equal arguments give an equal tree.

    The height of the trunk's axis and the stem's radius above the root flare, both m, are drawn by
    default; `density` is the number of branches relative to the template. The `Tree` has z up, its
    foot at the origin, parents before children, orders and the end of the trunk by the rule of the
    labels. Raises a ValueError if the height or the trunk radius is not positive, or below what the
    tips need.
    """
    rng = np.random.default_rng([int(seed), 211])
    drawn_height, drawn_ratio = rng.uniform(*parameters.height), rng.uniform(*parameters.ratio)
    height = drawn_height if height is None else float(height)
    radius = drawn_ratio * height if trunk_radius is None else float(trunk_radius)
    if not (height > 0.2 and radius > 2 * parameters.tip_radius[0]):
        raise ValueError(
            f"a tree needs a height over 0.2 m and a trunk radius over "
            f"{2 * parameters.tip_radius[0]} m, got {height} and {radius}"
        )
    grower = _Grower(parameters, rng, seed, density)
    bare = rng.uniform(*parameters.base_size)
    n_forks = int(rng.integers(parameters.base_splits[0], parameters.base_splits[1] + 1))
    lean = np.radians(rng.normal() * 1.2)
    frame = _rotated(np.eye(3), rng.uniform(0, 2 * np.pi), lean)
    length = height * parameters.levels[0].length
    if n_forks:
        trunk = grower.stem(0, np.zeros(3), frame, bare * length, radius, taper=FORK_TAPER)
        grower.fork(trunk, length, n_forks)
    else:
        grower.stem(0, np.zeros(3), frame, length, radius, bare=bare)
    while grower.waiting:
        grower.bear(grower.waiting.pop(0))
    if parameters.ageing is not None:
        age_tree(grower.tree, rng, parameters.ageing, radius)
    end_trunk_by_rule(grower.tree)
    return grower.tree
