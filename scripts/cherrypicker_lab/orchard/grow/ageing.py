"""What years of bearing and pruning make of a grown tree: thick wood, heavy cuts, burls, flutes.

A limb's area of section is that of all that it carries, and ever carried: the pipe model of
Shinozaki et al., "A quantitative analysis of plant form" (1964), in which the wood that fed a limb
stays when the limb is taken off. So an axis thins at each fork and each cut by the branch's area.
"""

from dataclasses import dataclass

import numpy as np

from cherrypicker_lab.orchard.grow.tree import Axis, aside

MEASURED_M, CLEAR_M = 0.30, 0.18  # no cut and no burl so near to where a stem is measured
CUT_SHARE = 0.55  # a cut is at most so wide, of the wood that it is on: the trunk goes on past it
CHILD_SHARE = 0.95  # a child is at most so thick, of its parent where it starts
COLLAR = 0.25  # how much wider the foot of a stub is
STEP_M = 0.01
N_ANGLES = 36
ROUND_M, FLUTED_M = 0.015, 0.04  # radius up to which wood is round, and from which it is fluted


@dataclass(frozen=True)
class Ageing:
    """Ranges (low, high) from which the marks of age are drawn; shares are of the radius."""

    cuts: tuple = (3, 7)  # stubs of sawn-off limbs, on the trunk and the scaffolds
    cut_radius: tuple = (0.015, 0.040)  # their radius, m
    stub: tuple = (0.2, 1.0)  # how far they stand out of the bark, in diameters
    burls: tuple = (1, 4)
    burl_height: tuple = (0.15, 0.45)  # how far a burl stands out, as a share
    # oval, flutes: depth of the section's second harmonic, and of its third to fifth, as shares
    oval: tuple = (0.02, 0.12)
    flutes: tuple = (0.005, 0.03)


def age_tree(tree, rng, ageing, radius):
    """Make a tree old, in place: its radii, stubs of sawn-off limbs, sections, burls.

    Parents come before children; `radius` is the stem's at 0.30 m, before burls, m.
    """
    _thicken(tree, rng, ageing, radius)
    _roughen(tree, rng, ageing)


def _thicken(tree, rng, ageing, radius):
    """Radii by the pipe model, and stubs.

    Areas are raised to the power that gives the stem its radius: what is the thicker at a fork
    stays the thicker.
    """
    own = [axis.radii.copy() for axis in tree.axes]
    tip = min(r[-1] for r in own)
    power = _set_radii(tree, own, tip, radius)
    for _ in range(int(rng.integers(ageing.cuts[0], ageing.cuts[1] + 1))):
        stub = _stub(rng, tree, ageing)
        if stub is not None:
            tree.axes.append(stub)
            own.append(tip * (stub.radii / tip) ** (1.0 / power))
    _set_radii(tree, own, tip, radius)
    for axis in tree.axes:
        if axis.is_cut:
            foot = tree.axes[axis.parent].radii[axis.parent_node]
            base = min(axis.radii[0], 0.8 * foot)
            axis.radii = base * (1.0 + COLLAR * np.exp(-((axis.arclength / foot) ** 2)))
            axis.radii = np.minimum(axis.radii, CHILD_SHARE * foot)


def _set_radii(tree, own, tip, radius):
    """Radii by the pipe model; returns the power that gives the stem its radius."""
    areas = [r**2 for r in own]
    for number in range(len(tree.axes) - 1, 0, -1):
        axis = tree.axes[number]
        areas[axis.parent][: axis.parent_node + 1] += areas[number][0]
    stem = tree.axes[0]
    node = min(int(np.searchsorted(stem.points[:, 2], MEASURED_M)), len(stem.points) - 1)
    power = np.log(radius / tip) / np.log(np.sqrt(areas[0][node]) / tip)
    for axis, area in zip(tree.axes, areas):
        radii = tip * (np.sqrt(area) / tip) ** power
        radii = _smooth(radii, 2 * int(radii[0] / STEP_M) + 1)
        if axis.parent >= 0:
            foot = tree.axes[axis.parent].radii[axis.parent_node]
            radii = np.minimum(radii, CHILD_SHARE * foot)
        axis.radii = radii
    return power


def _smooth(values, width):
    """Running mean over an odd number of nodes: what falls goes on falling."""
    padded = np.pad(values, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


def _thick_nodes(tree, least):
    """Axis and node of trunk and scaffolds of a radius, off the ends of its axis, shape (n, 2)."""
    places = []
    for number, axis in enumerate(tree.axes):
        if axis.order > 1 or axis.is_cut:
            continue
        rows = np.flatnonzero(axis.radii >= least)
        way = axis.arclength
        # one fork at a time: the trunk's end is judged a diameter below and above each
        room = 3 * axis.radii[0]
        rows = rows[(way[rows] > room) & (way[-1] - way[rows] > room)]
        if number == 0:
            rows = rows[np.abs(axis.points[rows, 2] - MEASURED_M) > CLEAR_M]
        places += [(number, row) for row in rows]
    return np.array(places, dtype=int).reshape(-1, 2)


def _stub(rng, tree, ageing):
    """What is left of a limb that was sawn off, None where all wood is too thin."""
    places = _thick_nodes(tree, ageing.cut_radius[0] / CUT_SHARE)
    if not len(places):
        return None
    number, node = places[rng.integers(len(places))]
    mother = tree.axes[number]
    foot = mother.radii[node]
    radius = rng.uniform(ageing.cut_radius[0], min(ageing.cut_radius[1], CUT_SHARE * foot))
    direction, angle = aside(rng, mother.tangents[node], 45.0, 80.0)
    length = foot / np.sin(angle) + 2 * radius * rng.uniform(*ageing.stub)
    way = np.linspace(0.0, length, int(np.ceil(length / STEP_M)) + 1)
    points = mother.points[node] + way[:, None] * direction
    return Axis(
        points, np.full(len(way), radius), mother.order + 1, int(number), int(node), is_cut=True
    )


def _roughen(tree, rng, ageing):
    """Oval and fluted sections, of the same area, and burls, which add to it."""
    angle = np.arange(N_ANGLES) * 2 * np.pi / N_ANGLES
    places = _thick_nodes(tree, ROUND_M + 0.5 * (FLUTED_M - ROUND_M))
    n_burls = int(rng.integers(ageing.burls[0], ageing.burls[1] + 1)) if len(places) else 0
    burls = places[rng.integers(len(places), size=n_burls)] if n_burls else places[:0]
    for number, axis in enumerate(tree.axes):
        if axis.is_cut or axis.radii.max() <= ROUND_M:
            continue
        outline = _fluted(rng, axis, ageing, angle)
        for node in burls[burls[:, 0] == number, 1]:
            outline += _burl(rng, axis, node, ageing, angle)
        wider = np.sqrt((outline**2).mean(axis=1))
        axis.section, axis.radii = outline / wider[:, None], axis.radii * wider


def _fluted(rng, axis, ageing, angle):
    """Distance of the surface from the axis, of the radius, (n, k); its mean square is 1."""
    way = axis.arclength[:, None]
    old = np.clip((axis.radii - ROUND_M) / (FLUTED_M - ROUND_M), 0.0, 1.0)[:, None]
    # round where axes meet, so that no edge shows
    ends = way[-1] - way if axis.parent < 0 else np.minimum(way, way[-1] - way)
    old = old * (1.0 - np.exp(-((ends / (2 * axis.radii[:, None])) ** 2)))
    twist = rng.normal(0.0, 0.5)  # radians a metre
    outline = np.ones((len(way), len(angle)))
    for harmonic in (2, 3, 4, 5):
        depth = rng.uniform(*(ageing.oval if harmonic == 2 else ageing.flutes))
        turn = rng.uniform(0, 2 * np.pi)
        outline += depth * old * np.cos(harmonic * (angle - twist * way) + turn)
    return outline / np.sqrt((outline**2).mean(axis=1, keepdims=True))


def _burl(rng, axis, node, ageing, angle):
    """A swelling on one side, of the radius, (n, k)."""
    way = axis.arclength
    long = rng.uniform(0.4, 0.9) * axis.radii[node]
    along = np.exp(-0.5 * ((way - way[node]) / long) ** 2)
    around = np.exp(rng.uniform(2.0, 5.0) * (np.cos(angle - rng.uniform(0, 2 * np.pi)) - 1.0))
    return rng.uniform(*ageing.burl_height) * along[:, None] * around
