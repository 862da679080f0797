"""Pruning by evidence: a side end stays where points show wood that nothing else explains."""

import logging

import numba
import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.geometry.edge_search import sections_around
from cherrypicker.skeleton.axes import axes

__all__ = ["prune_stem_strays", "prune_unseen"]

logger = logging.getLogger(__name__)

CLEAR_IN_NOISE = 3.0  # standard deviations outside the other wood where a point counts
LEAST_CLEAR = 0.6  # spacings
MOST_AWAY = 2.0  # spacings beyond its radius that a way's own points may lie from it
LEAST_POINTS = 5
LEAST_PER_SPACING = 0.5  # points a spacing of way beyond the other wood
NEAR_SECTIONS = 6
MOST_ROUNDS = 30
DEAD = -2


def prune_unseen(skeleton, surface, spacing, noise):
    """Remove the ends of a skeleton that no surface points of their own show.

    A way from a tip to the junction before it is seen when enough points lie nearest to it and
    clearly outside the wood of all other ways. Pruning repeats, the least seen first, since what
    two ways share belongs to the one that stays.

    Parameters
    ----------
    skeleton : Skeleton
        With radii.
    surface : ndarray of shape (n_points, 3), float64
    spacing : float
    noise : float
        Standard deviation of the surface points around the wood.

    Returns
    -------
    Skeleton
    """
    clear = max(CLEAR_IN_NOISE * noise, LEAST_CLEAR * spacing)
    most_away = MOST_AWAY * spacing + 3 * noise
    evidence = _Evidence(skeleton, surface, spacing, clear, most_away)
    alive = np.ones(len(skeleton), dtype=bool)
    for _ in range(MOST_ROUNDS):
        own, ends = _terminal_ways(skeleton.select(alive))
        way = np.full(len(skeleton), DEAD, dtype=np.int64)
        way[alive] = own
        seen, wanted = evidence.of(way, len(ends))
        weak = np.flatnonzero(seen < wanted)
        if not len(weak):
            break
        share = (seen / wanted)[weak]
        first = {}
        for index in weak[np.lexsort((weak, share))]:  # one a junction: the other may then stay
            first.setdefault(ends[index], index)
        alive[np.isin(way, list(first.values()))] = False
    logger.info("pruned %d nodes that no points of their own show", np.count_nonzero(~alive))
    return skeleton.select(alive)


def prune_stem_strays(skeleton, spacing, noise):
    """Remove side ends that run in the stem itself.

    At the rims of holes a contraction leaves strands of stem points beside the stem's axis. A
    stem is one axis: an end that never leaves its thickness is no branch.

    Parameters
    ----------
    skeleton : Skeleton
        With radii that fall from base to tip.
    spacing, noise : float
        As for `prune_unseen`.

    Returns
    -------
    Skeleton
    """
    n_before = len(skeleton)
    for _ in range(MOST_ROUNDS):
        stem = axes(skeleton)[0].nodes
        way, ends = _terminal_ways(skeleton)
        way[stem] = -1
        side = np.flatnonzero(way >= 0)
        away, near = cKDTree(skeleton.points[stem]).query(skeleton.points[side])
        radius = np.maximum.accumulate(skeleton.radius[stem][::-1])[::-1][near]
        clear = max(CLEAR_IN_NOISE * noise, LEAST_CLEAR * spacing)
        leaves = np.bincount(way[side], away > radius + clear, len(ends)) > 0
        stray = np.flatnonzero((np.bincount(way[side], minlength=len(ends)) > 0) & ~leaves)
        if not len(stray):
            break
        skeleton = skeleton.select(~np.isin(way, stray))
    logger.info("pruned %d nodes of strands in the stem", n_before - len(skeleton))
    return skeleton


def _terminal_ways(skeleton):
    """Terminal way of each node (-1 for none), and the junction that each way ends at."""
    return _ways(skeleton.parent, skeleton.n_children)


@numba.njit(cache=True)
def _ways(parent, n_children):
    way = np.full(len(parent), -1, dtype=np.int64)
    ends, n_ways = np.empty(len(parent), dtype=np.int64), 0
    for tip in range(len(parent)):
        if n_children[tip]:
            continue
        node = tip
        while node > 0 and n_children[node] <= 1:
            way[node] = n_ways
            node = parent[node]
        if node == 0 and n_children[0] <= 1:
            for other in range(len(parent)):  # the only axis
                if way[other] == n_ways:
                    way[other] = -1
            continue
        ends[n_ways] = node
        n_ways += 1
    return way, ends[:n_ways]


class _Evidence:
    """The wood around each surface point and around each place along a skeleton.

    Both are kept by sections, the pieces of the skeleton between junctions and tips: whatever is
    pruned, a way consists of whole sections.
    """

    def __init__(self, skeleton, surface, spacing, clear, most_away):
        n_steps = np.maximum(np.ceil(skeleton.edge_length / spacing).astype(np.int64), 1)
        node = np.repeat(np.arange(len(skeleton)), n_steps)
        start = np.repeat(np.cumsum(n_steps) - n_steps, n_steps)
        share = (np.arange(len(node)) - start) / n_steps[node]
        step = skeleton.points[np.maximum(skeleton.parent, 0)] - skeleton.points
        places = skeleton.points[node] + share[:, None] * step[node]
        section = _sections(skeleton.parent, skeleton.n_children)
        self.own = section[node]
        nothing = np.full(len(surface), -1)
        limits = max(clear, most_away), clear
        around = (surface, nothing), (places, self.own)
        self.around, self.beside = (
            sections_around(skeleton, section, *which, limit, NEAR_SECTIONS)
            for which, limit in zip(around, limits)
        )
        self.limits = clear, most_away

    def of(self, way, n_ways):
        """Points of its own that each terminal way has, and how many it needs.

        `way` holds the terminal way of each node, -1 for none and `DEAD` for those cut off.
        """
        seen, free = _count(way, n_ways, *self.around, self.own, *self.beside, *self.limits)
        return seen, np.maximum(LEAST_POINTS, LEAST_PER_SPACING * free)


@numba.njit(cache=True)
def _sections(parent, n_children):
    """Upper end of the piece between junctions that each node belongs to."""
    section = np.arange(len(parent))
    for node in range(len(parent) - 1, 0, -1):
        if n_children[parent[node]] == 1:
            section[parent[node]] = section[node]
    return section


@numba.njit(cache=True)
def _count(way, n_ways, near, outside, own, beside, between, clear, most_away):
    """Surface points of each way that lie clear of other wood, and places of it that do."""
    seen, free = np.zeros(n_ways), np.zeros(n_ways)
    for row in range(len(near)):
        mine, others = DEAD, np.inf
        for at in range(near.shape[1]):
            if near[row, at] < 0:
                break
            which = way[near[row, at]]
            if which in (DEAD, mine):
                continue
            if mine != DEAD:
                others = outside[row, at]
                break
            mine = which if outside[row, at] < most_away else -1
            if mine < 0:
                break
        if mine >= 0 and others > clear:
            seen[mine] += 1
    for row in range(len(own)):
        mine, others = way[own[row]], np.inf
        if mine < 0:
            continue
        for at in range(beside.shape[1]):
            if beside[row, at] < 0:
                break
            which = way[beside[row, at]]
            if which not in (DEAD, mine):
                others = between[row, at]
                break
        free[mine] += others > clear
    return seen, free
