"""Poles among the limbs: tubes, or stretches of them, that are as straight and as even as no wood.

A post beside a stem touches its branches, and limbs that are grown on both go from one into the
other. So a pole is looked for in each stretch of a tube, and is a cylinder that goes on as far as
its points do. Wood bends and thins over the length of one.
"""

from __future__ import annotations

import numpy as np

from cherrypicker.geometry.neighbors import rows_in_box
from cherrypicker.limbs.tubes import Tube, claim_radius

__all__ = ["in_cylinder", "pole_rows"]

# In radii: a stretch of a pole is at least so long and bends so far at most, and its slices differ
# by so much. Of 20 held-out generated scenes and four scans of trees without a post, 27 of 31
# stretches of posts differ by 0.06 at most, the others, of thin stakes, by up to 0.11; the least of
# wood with as many points is 0.2 (2026-11-25, all slices counted).
SLENDER, STRAIGHT, EVEN = 15.0, 0.3, 0.1
N_SLICES = 8


def pole_rows(points: np.ndarray, tube: Tube, spacing: float) -> np.ndarray:
    """Rows of the points (n, 3) of the pole that a tube follows over some of its length, or none.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
        Of the stem that the tube is grown on.
    tube : Tube
    spacing : float
        Of the points.

    Returns
    -------
    ndarray of shape (n_rows,), int
    """
    none = np.empty(0, int)
    found = _even_stretch(tube)
    if found is None:
        return none
    middle, along, radius, length = found
    reach = float(claim_radius(np.array([radius]), spacing)[0])
    box = np.abs(along) * length / 2 + reach
    near = points[rows_in_box(points, middle - box, middle + box)]
    _, way, aside = in_cylinder(near, middle, along, reach)
    inside = np.abs(way) <= length / 2
    if not _is_even(way[inside], aside[inside], radius):
        return none
    rows, way, aside = in_cylinder(points, middle, along, reach)
    piece = np.cumsum(np.diff(way, prepend=way[:1]) > 2 * radius)
    main = np.isin(piece, piece[np.abs(way) <= length / 2])
    if not _is_even(way[main], aside[main], radius):
        return none
    level = np.array(
        [np.median(each) for each in np.split(aside, np.flatnonzero(np.diff(piece)) + 1)]
    )
    return rows[np.abs(level - np.median(aside[main]))[piece] <= EVEN * radius]


def in_cylinder(
    points: np.ndarray, middle: np.ndarray, along: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the points (n, 3) near a line, where they are along it, in order, and how far off."""
    offset = points - middle
    way = offset @ along
    aside = np.linalg.norm(offset - way[:, None] * along, axis=1)
    rows = np.flatnonzero(aside <= reach)
    rows = rows[np.argsort(way[rows])]
    return rows, way[rows], aside[rows]


def _is_even(way: np.ndarray, aside: np.ndarray, radius: float) -> bool:
    """Whether points, sorted along a line, are equally far off it all along.

    The least and the most of the slices are left out: a branch that crosses moves one.
    """
    if len(way) < N_SLICES**2:  # a slice's median tells little of fewer
        return False
    ends = np.searchsorted(way, np.linspace(way[0], way[-1], N_SLICES + 1)[1:-1])
    level = [np.median(each) for each in np.split(aside, ends) if len(each)]
    return bool(np.ptp(np.sort(level)[1:-1]) <= EVEN * radius)


def _even_stretch(tube: Tube) -> tuple[np.ndarray, np.ndarray, float, float] | None:
    """Middle, direction, radius and length of a tube's longest stretch that is a cylinder."""
    nodes, radius, way = tube.nodes, tube.radius, tube.way
    best, first = (0, 1), 0
    for past in range(2, len(nodes) + 1):
        while not _is_cylinder(nodes[first:past], radius[first:past]):
            first += 1
        if way[past - 1] - way[first] > way[best[1] - 1] - way[best[0]]:
            best = (first, past)
    own = slice(*best)
    middle, thickness = nodes[own].mean(axis=0), float(np.median(radius[own]))
    length = float(way[own][-1] - way[own][0])
    if length < SLENDER * thickness:
        return None
    along = np.linalg.svd(nodes[own] - middle, full_matrices=False)[2][0]
    return middle, along, thickness, length


def _is_cylinder(nodes: np.ndarray, radius: np.ndarray) -> bool:
    """Whether a tube's nodes lie on a line, near it for their radius, which is even."""
    if len(nodes) <= 2:
        return True
    if np.ptp(radius) > EVEN * radius[0]:
        return False
    chord = nodes[-1] - nodes[0]
    offset = nodes - nodes[0]
    share = offset @ chord / (chord @ chord)
    bend = np.linalg.norm(offset - share[:, None] * chord, axis=1).max()
    return bool(bend <= STRAIGHT * radius[0])
