"""Leafless fruit trees grown year by year from a whip, so that each node knows its year.

Every year each living tip adds an increment, long or short, and the long wood of the year before
breaks into long shoots near its end and short ones below (acrotony). A bud of older wood breaks now
and then, a pruner heads some shoots. Radii follow the pipe model (Shinozaki et al., 1964) and a
ring a year. Lengths and numbers are guesses for cherry and apple trees, drawn anew for each tree.
"""

from dataclasses import dataclass, replace

import numpy as np

from cherrypicker_lab.orchard.grow.growth import curve
from cherrypicker_lab.orchard.grow.tree import Axis, Tree, aside, without

SHORT_M = 0.05  # an increment below is a short shoot (Costes et al., Hort. Reviews 32:1, 2006)


@dataclass(frozen=True)
class YearForm:
    """Ranges (low, high) that a tree is drawn from. Lengths m, angles degrees, shares of 1."""

    name: str
    years: tuple = (4, 8)
    leader: tuple = (0.35, 0.6)  # long increment of order 0
    weaker: tuple = (0.6, 0.8)  # by which an order's increments are shorter than the one before
    fade: tuple = (0.82, 0.95)  # and those of a year, as an axis ages
    spread: tuple = (0.2, 0.35)  # of the logarithm of a length
    long_a_m: tuple = (2.5, 5.0)  # long shoots a metre of last year's wood
    short_a_m: tuple = (6.0, 14.0)  # short ones
    turns_short: tuple = (0.08, 0.25)  # chance that a long axis goes on by short increments
    late_a_m: tuple = (0.05, 0.3)  # shoots a metre and year of older wood
    spur_m: tuple = (0.006, 0.03)  # increment of a short axis
    spur_dies: tuple = (0.02, 0.12)  # a year
    headed: tuple = (0.0, 0.15)  # of the long tips, a year
    angle: tuple = (45.0, 70.0)
    upturn: tuple = (0.2, 1.0)
    stem_clear: tuple = (0.4, 0.6)  # height below which nothing is left
    most_orders: int = 3
    forked: bool = False
    tip_radius: tuple = (0.0016, 0.0024)
    shoot_taper: tuple = (0.004, 0.007)  # radius a metre of one-year wood
    pipe: tuple = (2.1, 2.6)  # exponent
    ring: tuple = (0.0003, 0.0009)


YEAR_FORMS = {
    "leader": YearForm("leader"),
    "vase": YearForm("vase", forked=True, headed=(0.1, 0.3), angle=(30.0, 50.0)),
    "spindle": YearForm(
        "spindle",
        leader=(0.45, 0.75),
        weaker=(0.5, 0.7),
        long_a_m=(4.0, 7.0),
        angle=(65.0, 90.0),
        upturn=(0.0, 0.4),
        turns_short=(0.15, 0.35),
    ),
    "weak_apple": YearForm(
        "weak_apple",
        leader=(0.25, 0.45),
        short_a_m=(10.0, 20.0),
        spur_m=(0.004, 0.02),
        turns_short=(0.2, 0.4),
        tip_radius=(0.0018, 0.0028),
        ring=(0.0005, 0.0012),
    ),
}


class _Growing:
    """A tree's numbers, and its axes as they grow."""

    def __init__(self, form, rng):
        self.form, self.rng, self.axes, self.is_short, self.lives = form, rng, [], [], []
        ranges = {k: v for k, v in vars(form).items() if isinstance(v, tuple) and k != "years"}
        ranges = {k: v for k, v in ranges.items() if k not in ("angle", "upturn", "spur_m")}
        self.n = {name: rng.uniform(*ends) for name, ends in ranges.items()}

    def start(self, parent, node, order, is_short, year, length):
        rng, mother = self.rng, self.axes[parent] if parent >= 0 else None
        if mother is None:
            place, way, upturn = np.zeros(3), np.append(rng.normal(size=2) * 0.02, 1.0), 0.1
        else:
            way, _ = aside(rng, mother.tangents[node], *self.form.angle)
            place, upturn = mother.points[node], rng.uniform(*self.form.upturn)
        points = curve(rng, place, way, length, wiggle=0.35, upturn=upturn)
        years = np.full(len(points), year)
        self.axes.append(Axis(points, np.empty(0), order, parent, node, years=years))
        self.is_short.append(is_short)
        self.lives.append(True)

    def long_length(self, axis, age):
        order = min(axis.order, 3)
        mean = self.n["leader"] * self.n["weaker"] ** order * self.n["fade"] ** age
        drawn = mean * np.exp(self.rng.normal(0.0, self.n["spread"]))
        return max(drawn, 1.2 * SHORT_M)

    def extend(self, number, year):
        axis, rng = self.axes[number], self.rng
        if not self.is_short[number] and axis.order and rng.random() < self.n["turns_short"]:
            self.is_short[number] = True
        length = rng.uniform(*self.form.spur_m)
        if not self.is_short[number]:
            length = self.long_length(axis, year - axis.years[0])
        more = curve(rng, axis.points[-1], axis.tangents[-1], length, wiggle=0.35, upturn=0.2)[1:]
        self.axes[number] = replace(
            axis,
            points=np.vstack([axis.points, more]),
            years=np.append(axis.years, np.full(len(more), year)),
        )

    def branch(self, number, year):
        """Laterals of this year on one axis."""
        axis, rng = self.axes[number], self.rng
        height, last = axis.points[:, 2], axis.years == year - 1
        old = (axis.years < year - 1) & (height > self.n["stem_clear"])
        places = []
        if 0.01 * last.sum() >= SHORT_M:
            rows = np.flatnonzero(last & (height > self.n["stem_clear"]))[1:-1]
            length = 0.01 * len(rows)
            upper = rows[len(rows) // 3 :]
            places += [(n, False) for n in self.some(upper, self.n["long_a_m"] * length)]
            places += [(n, True) for n in self.some(rows, self.n["short_a_m"] * length)]
        if old.any() and not self.is_short[number]:
            rows = np.flatnonzero(old)[1:]
            late = self.some(rows, self.n["late_a_m"] * 0.01 * len(rows))
            places += [(n, rng.random() < 0.5) for n in late]
        taken = {a.parent_node for a in self.axes if a.parent == number}
        for node, is_short in places:
            if node in taken:
                continue
            taken.add(node)
            stays_short = is_short or axis.order + 1 > self.form.most_orders
            way = rng.uniform(*self.form.spur_m)
            if not stays_short:
                way = self.long_length(replace(axis, order=axis.order + 1), 0)
            self.start(number, int(node), axis.order + 1, stays_short, year, way)

    def some(self, rows, mean):
        if not len(rows):
            return ()
        return self.rng.choice(rows, min(self.rng.poisson(mean), len(rows)), False)

    def head(self, number):
        """A pruner takes the end off last year's shoot."""
        axis = self.axes[number]
        rows = np.flatnonzero(axis.years == axis.years[-1])
        borne = [a.parent_node for a in self.axes if a.parent == number]
        keep = max([rows[0] + int(self.rng.uniform(0.3, 0.7) * len(rows)), 4, *borne]) + 1
        self.axes[number] = axis.part(slice(keep))


def grow_years(seed, form="leader", *, years=None):
    """Grow a tree of known years, z up, its foot at the origin.

    The form is a `YearForm` or a key of `YEAR_FORMS`, its age is drawn by default. Each axis has
    its ``years``, 1 for the whip's.
    """
    form = YEAR_FORMS[form] if isinstance(form, str) else form
    rng = np.random.default_rng([int(seed), 401])
    growing = _Growing(form, rng)
    drawn = int(rng.integers(form.years[0], form.years[1] + 1))
    last = drawn if years is None else int(years)
    growing.start(-1, -1, 0, False, 1, rng.uniform(0.9, 1.3))
    for year in range(2, last + 1):
        for number in range(len(growing.axes)):
            axis, is_short = growing.axes[number], growing.is_short[number]
            if is_short and rng.random() < growing.n["spur_dies"]:
                growing.lives[number] = False
            if not growing.lives[number]:
                continue
            if form.forked and number == 0:
                if year == 2:
                    growing.branch(number, year)
                continue
            if not is_short and axis.order and rng.random() < growing.n["headed"]:
                growing.head(number)
            growing.branch(number, year)
            growing.extend(number, year)
    axes = _thicken(growing, last)
    return Tree(form.name, axes, int(seed))


def _thicken(growing, last):
    """Radii by pipes and rings, of the axes that live and what bears them."""
    n, rng, axes = growing.n, growing.rng, growing.axes
    kept = list(growing.lives)
    for number in range(len(axes) - 1, 0, -1):
        kept[axes[number].parent] |= kept[number]
    axes = without(axes, set(np.flatnonzero(~np.array(kept)).tolist()))
    pipe = n["pipe"]
    area = [np.zeros(len(axis.points)) for axis in axes]
    for number in range(len(axes) - 1, -1, -1):
        axis = axes[number]
        tip = n["tip_radius"] * np.exp(rng.normal(0.0, 0.12))
        way = axis.arclength
        since = np.minimum(way[-1] - way, 0.6)
        own = tip + n["shoot_taper"] * since
        area[number] += own**pipe
        if axis.parent >= 0:
            area[axis.parent][: axis.parent_node + 1] += 0.8 * area[number][0]
    for number, axis in enumerate(axes):
        age = last - axis.years
        axis.radii = area[number] ** (1.0 / pipe) + n["ring"] * age
        axis.radii = np.minimum.accumulate(axis.radii)
        if axis.parent >= 0:
            axis.radii = np.minimum(axis.radii, 0.8 * axes[axis.parent].radii[axis.parent_node])
    return axes


def node_ages(tree):
    """Age of each node of ``tree.skeleton()`` in years, 1 for this year's wood, (n,) int64."""
    last = max(int(axis.years[-1]) for axis in tree.axes)
    return last + 1 - tree.at_nodes([axis.years for axis in tree.axes])


def node_is_spur(tree):
    """Whether each node's increment and all beyond it are short, (n,) bool."""
    flags = [np.ones(len(axis.points), bool) for axis in tree.axes]
    for number in range(len(tree.axes) - 1, -1, -1):
        axis, short = tree.axes[number], flags[number]
        way, bears_long = axis.arclength, False
        for year in np.unique(axis.years)[::-1]:
            rows = np.flatnonzero(axis.years == year)
            length = way[rows[-1]] - way[max(rows[0] - 1, 0)]
            bears_long |= length >= SHORT_M or not short[rows].all()
            short[rows] &= not bears_long
        if axis.parent >= 0 and not short[min(1, len(short) - 1)]:
            flags[axis.parent][: axis.parent_node + 1] = False
    return tree.at_nodes(flags)
