"""Poles and wires among the limbs: stretches of tubes that are as straight and as even as no wood.

A post beside a stem touches its branches, a wire runs through a crown, and limbs that are grown on
both go from one into the other. So a pole is looked for in each stretch of a tube, and is a
cylinder that goes on as far as its points do. Wood bends and thins over the length of one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from cherrypicker.geometry.directions import tangent_basis, unit
from cherrypicker.geometry.robust import CAUCHY, robust_sigma
from cherrypicker.geometry.sections import LEAST_NOISE
from cherrypicker.limbs.tubes import Tube, claim_radius

# In radii: a pole is at least so long and bends so far at most, and its slices differ by so much.
# Of 20 held-out generated scenes and four scans of trees without a post, 27 of 31 stretches of
# posts differ by 0.06 at most, the others, of thin stakes, by up to 0.11; the least of wood with as
# many points is 0.2 (2026-11-25, all slices counted). Circles through the slices of 24 posts stray
# by up to 0.11, of one by 0.23, of the stem that is as even by 0.17 (2026-11-29).
SLENDER, STRAIGHT, EVEN = 15.0, 0.15, 0.1
N_SLICES = 8
# Of its length: what is thin is straight and even to so much. Slices of two wires of 1.7 and 1.9 m
# lie within 0.0008 of a line, those of the straightest limbs of two other trees 0.004 off and more
# (2026-11-26)
TAUT = 0.0015
# Of a thin one's reach: stray points of a wire lie no farther off. Of 4,733 points of one 0.99 do,
# of one seen from farther away three quarters (6 finds no more of it, 2026-11-26)
HALO = 3.0

_median = partial(np.median, axis=0)


@dataclass(frozen=True)
class Pole:
    """A cylinder."""

    middle: np.ndarray  # (3,)
    along: np.ndarray  # (3,): its direction
    length: float
    # By which the median distances of its pieces from its axis differ at most: all of its reach
    # where it is thinner than its points are apart, which show no surface of it
    slack: float
    reach: float  # how far its points lie off its axis at most
    is_even: bool  # whether its slices are as even as its radius asks, however long it is

    def rows(self, points: np.ndarray) -> np.ndarray:
        """Rows of its points among others (n, 3), hidden stretches left out, along its way."""
        rows, way, aside = in_cylinder(points, self.middle, self.along, self.reach)
        piece = _pieces(way, 2 * self.reach)
        level = _told(piece, aside)
        inside = np.abs(way) <= self.length / 2
        own = np.median(aside[inside]) if inside.any() else np.inf
        return rows[np.abs(level - own)[piece] <= self.slack]

    def holds(self, middle: np.ndarray, along: np.ndarray) -> bool:
        """Whether a stretch of a line, its middle (3,) and direction (3,), is its own."""
        rows, way, _ = in_cylinder(middle[None], self.middle, self.along, self.reach)
        is_along = np.linalg.norm(np.cross(along, self.along)) <= 2 / SLENDER
        return bool(len(rows) and abs(way[0]) <= self.length / 2 and is_along)

    def halo(self) -> Pole:
        """The same with its stray points."""
        return replace(self, reach=HALO * self.reach, slack=HALO * self.reach)

    def is_free(self, points: np.ndarray) -> bool:
        """Whether both of its ends are in the air: at neither are more of the points (n, 3) others.

        A shoot hangs on something; a wire is held far away, and what it passes is between its ends.
        Others lie around an end and go on from there: farther than stray points of its own.
        """
        rows, halo = self.rows(points), HALO * self.reach
        if not len(rows):
            return False
        near, way, aside = in_cylinder(points, self.middle, self.along, 2 * halo)
        is_own = np.isin(near, rows)
        low, high = way[is_own][[0, -1]]
        is_beside = (aside <= halo) & (low < way) & (way < high)  # a stray point
        for end in (low, high):
            away = np.hypot(way - end, aside)
            around, beyond = away <= halo, (away > halo) & (away <= 2 * halo) & ~is_beside
            n_others = min(np.count_nonzero(~is_own & each) for each in (around, beyond))
            if n_others > np.count_nonzero(is_own & (np.abs(way - end) <= 2 * self.reach)):
                return False
        return True


def find_poles(points: np.ndarray, tube: Tube, spacing: float) -> list[Pole]:
    """The poles and wires that a tube follows over some of its length.

    The points (n, 3), `spacing` apart, are those that the tube is grown on.
    """
    found = list[Pole]()
    for middle, along, radius, length in _even_stretches(tube, spacing):
        if not any(pole.holds(middle, along) for pole in found):
            pole = _along_line(points, middle, along, radius, length, spacing)
            found += [pole] if pole else []
    return found


def _along_line(
    points: np.ndarray,
    middle: np.ndarray,
    along: np.ndarray,
    radius: float,
    length: float,
    spacing: float,
) -> Pole | None:
    """The pole that a stretch of a tube is a part of, None where its points make none."""
    reach = float(claim_radius(np.array([radius]), spacing)[0])
    while True:  # the line grows with its points
        rows, way, aside = in_cylinder(points, middle, along, reach)
        inside = np.abs(way) <= length / 2
        slack = max(EVEN * radius, spacing)
        if _unevenness(way[inside], aside[inside]) > slack:
            return None
        # What hangs together with it is of it. Beyond a gap, where it may be hidden, it goes on in
        # what lies like it, not in other wood on its line
        piece, offset = _pieces(way, 2 * reach), points[rows] - middle - way[:, None] * along
        level, side = (_told(piece, each) for each in (aside, offset))
        lean = np.linalg.norm(side - np.median(offset[inside], axis=0), axis=1)
        surface = np.median(aside[inside])
        is_same = np.abs(level - surface) <= slack
        is_same &= lean <= max(STRAIGHT * radius, spacing)
        is_same[piece[inside]] = True
        same = np.flatnonzero(is_same[piece])
        piece = _pieces(way[same], max(2 * reach, length / 4))
        main = same[np.isin(piece, piece[inside[same]])]
        own, before, length = points[rows[main]], length, float(np.ptp(way[main]))
        if radius > spacing:
            middle, along = _axis(own, middle, along, surface)
        else:
            middle = own.mean(axis=0)
            along = np.linalg.eigh(np.cov(own - middle, rowvar=False))[1][:, -1]
        ends = (own[[0, -1]] - middle) @ along
        middle = middle + ends.mean() * along
        if length <= before + reach:
            break
    rows, way, aside = in_cylinder(points, middle, along, reach)
    main = np.abs(way) <= length / 2
    even, straight = (max(share * radius, TAUT * length) for share in (EVEN, STRAIGHT))
    uneven = _unevenness(way[main], aside[main])
    if length < SLENDER * max(radius, spacing) or uneven > even:
        return None
    # Wood that it touches is within reach, on one side
    main &= np.abs(aside - np.median(aside[main])) <= slack
    across = (points[rows[main]] - middle) @ tangent_basis(along).T
    # What is thinner than its points are apart shows no surface
    center = _circle_center if radius > spacing else _median
    bends = _told(_slices(way[main]), across, center)
    bends = np.sort(np.linalg.norm(bends - np.median(bends, axis=0), axis=1))
    if bends[-2] > straight:  # a branch that crosses moves one slice
        return None
    slack = even if radius > spacing else reach
    return Pole(middle, along, length, slack, reach, is_even=uneven <= EVEN * radius)


def _axis(
    points: np.ndarray, middle: np.ndarray, along: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Middle and direction of the cylinder through points (n, 3), from those of one near it.

    Least squares with Cauchy's loss over its line and radius: wood that it touches lies on one side
    of it, within its reach.
    """
    from scipy.optimize import least_squares

    basis = tangent_basis(along)

    def line(unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return middle + unknown[:2] @ basis, unit(along + unknown[2:4] @ basis)

    def off(unknown: np.ndarray) -> np.ndarray:
        start, way = line(unknown)
        return np.linalg.norm(np.cross(points - start, way), axis=1) - unknown[4]

    start = np.append(np.zeros(4), radius)
    scale = max(CAUCHY * robust_sigma(off(start)), LEAST_NOISE * radius)
    return line(least_squares(off, start, loss="cauchy", f_scale=scale, x_scale="jac").x)


def _pieces(way: np.ndarray, gap: float) -> np.ndarray:
    """Piece of each place along a line, in order: longer gaps part them."""
    return np.cumsum(np.diff(way, prepend=way[:1]) > gap)


def _slices(way: np.ndarray) -> np.ndarray:
    """Slice of each place along a line, in order: all are as long."""
    return np.searchsorted(np.linspace(way[0], way[-1], N_SLICES + 1)[1:-1], way, side="right")


def _told(
    piece: np.ndarray, values: np.ndarray, told: Callable[[np.ndarray], npt.ArrayLike] = _median
) -> np.ndarray:
    """What the values of points, sorted by their pieces, tell of each piece."""
    ends = np.flatnonzero(np.diff(piece)) + 1
    return np.array([told(each) for each in np.split(values, ends) if len(each)])


def in_cylinder(
    points: np.ndarray, middle: np.ndarray, along: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the points (n, 3) near a line, where they are along it, in order, and how far off."""
    offset = points - middle
    way = offset @ along
    square = np.einsum("ij,ij->i", offset, offset) - np.square(way)  # of how far off
    rows = np.flatnonzero(square <= reach**2)
    rows = rows[np.argsort(way[rows])]
    return rows, way[rows], np.sqrt(np.maximum(square[rows], 0.0))


def _circle_center(points: np.ndarray) -> np.ndarray:
    """Middle of the circle through points (n, 2), by least squares (Kåsa 1976).

    Unlike their median it does not depend on which sides are seen.
    """
    design = np.column_stack([2 * points, np.ones(len(points))])
    return np.linalg.lstsq(design, np.square(points).sum(axis=1), rcond=None)[0][:2]


def _unevenness(way: np.ndarray, aside: np.ndarray) -> float:
    """By how much the slices of points, sorted along a line, differ in how far off it they are.

    The least and the most of the slices are left out: a branch that crosses moves one. Infinite
    where no other has points, or there are too few.
    """
    if len(way) < N_SLICES**2:  # a slice's median tells little of fewer
        return np.inf
    levels = np.sort(_told(_slices(way), aside))[1:-1]
    return float(np.ptp(levels)) if len(levels) else np.inf


def _even_stretches(
    tube: Tube, spacing: float
) -> Iterator[tuple[np.ndarray, np.ndarray, float, float]]:
    """Middle, direction, radius and length of what of a tube is a cylinder longer than wide.

    Its nodes lie on a line, near it for their radius, which is even. Of the lines through two nodes
    that on which the most lies is taken, then of what is left (as RANSAC, Fischler and Bolles 1981,
    with nodes an even way apart for random ones): where a tube strays from a wire, or goes from one
    limb into another, it is on its line again.
    """
    center = tube.nodes.mean(axis=0)
    nodes, radius, way = tube.nodes - center, tube.radius, tube.way
    share, left = np.gradient(way), np.ones(len(way), bool)
    while True:
        some = np.flatnonzero(left)
        some = some[np.unique(way[some] // (2 * spacing), return_index=True)[1]]
        most, own, step = 0.0, np.zeros(len(way), bool), 1
        while step < len(some):
            is_on = left & _on_lines(nodes, radius, some[:-step], some[step:], spacing)
            total = is_on @ share
            if total.max() > most:
                most, own = float(total.max()), is_on[total.argmax()]
            step *= 2
        thickness = float(np.median(radius[own])) if own.any() else np.inf
        if most < 2 * max(thickness, spacing):
            return
        middle = nodes[own].mean(axis=0)
        line = np.linalg.svd(nodes[own] - middle, full_matrices=False)[2][0]
        yield middle + center, line, thickness, float(np.ptp((nodes[own] - middle) @ line))
        left &= ~own


def _on_lines(
    nodes: np.ndarray, radius: np.ndarray, first: np.ndarray, last: np.ndarray, spacing: float
) -> np.ndarray:
    """Which nodes (n_nodes, 3) continue the wood between two of them, (n_pairs, n_nodes) bool."""
    chord = unit(nodes[last] - nodes[first])
    along = chord @ nodes.T - (chord * nodes[first]).sum(axis=1)[:, None]
    square = np.square(nodes).sum(axis=1)
    away = square - 2 * nodes[first] @ nodes.T + square[first][:, None] - along**2
    thick = (radius[first] + radius[last])[:, None] / 2
    is_on = away <= np.square(np.maximum(STRAIGHT * thick, spacing))
    return is_on & (np.abs(radius - thick) <= np.maximum(EVEN * thick, spacing) / 2)
