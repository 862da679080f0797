"""Pruning by evidence: a side end stays where points show wood that nothing else explains."""

import logging

import numba
import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.skeleton.axes import axes

__all__ = ["prune_stem_strays", "prune_unseen"]

logger = logging.getLogger(__name__)

CLEAR_IN_NOISE = 3.0  # standard deviations outside the other wood where a point counts
LEAST_CLEAR = 0.6  # spacings
MOST_AWAY = 2.0  # spacings beyond its radius that a way's own points may lie from it
LEAST_POINTS = 5
LEAST_PER_SPACING = 0.5  # points a spacing of way beyond the other wood
NEIGHBORS = 12
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
    places = _Places(skeleton, surface, spacing)
    clear = max(CLEAR_IN_NOISE * noise, LEAST_CLEAR * spacing)
    alive = np.ones(len(skeleton), dtype=bool)
    for _ in range(MOST_ROUNDS):
        rows = np.flatnonzero(alive)
        own, ends = _terminal_ways(skeleton.select(alive))
        way = np.full(len(skeleton), DEAD, dtype=np.int64)
        way[rows] = own
        seen, wanted = places.evidence(way, len(ends), clear, MOST_AWAY * spacing + 3 * noise)
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
            way[way == n_ways] = -1  # the only axis
            continue
        ends[n_ways] = node
        n_ways += 1
    return way, ends[:n_ways]


class _Places:
    """Places along a skeleton and the nearest of them to each surface point, and to each other."""

    def __init__(self, skeleton, surface, spacing):
        n_steps = np.maximum(np.ceil(skeleton.edge_length / spacing).astype(np.int64), 1)
        self.node = np.repeat(np.arange(len(skeleton)), n_steps)
        start = np.repeat(np.cumsum(n_steps) - n_steps, n_steps)
        share = (np.arange(len(self.node)) - start) / n_steps[self.node]
        up = np.maximum(skeleton.parent, 0)
        step = (skeleton.points[up] - skeleton.points)[self.node]
        points = skeleton.points[self.node] + share[:, None] * step
        tree, k = cKDTree(points), min(NEIGHBORS, len(points))
        radius = skeleton.radius[self.node]
        distance, near = tree.query(surface, k=k)
        self.near = near.reshape(-1, k)
        self.outside = distance.reshape(-1, k) - radius[self.near]
        distance, near = tree.query(points, k=k)
        self.beside = near.reshape(-1, k)
        self.between = distance.reshape(-1, k) - radius[self.beside]

    def evidence(self, way, n_ways, clear, most_away):
        """Points of its own that each terminal way has, and how many it needs.

        `way` holds the terminal way of each node, -1 for none and `DEAD` for those cut off.
        """
        owner = way[self.node]
        outside = np.where(owner[self.near] == DEAD, np.inf, self.outside)
        rows = np.arange(len(outside))
        nearest = np.argmin(outside, axis=1)
        own = owner[self.near[rows, nearest]]
        others = np.where(owner[self.near] == own[:, None], np.inf, outside).min(axis=1)
        counts = (own >= 0) & (others > clear) & (outside[rows, nearest] < most_away)
        seen = np.bincount(own[counts], minlength=n_ways).astype(np.float64)
        # the length of each way beyond the other wood, over which the points should be spread
        other = (owner[self.beside] == owner[:, None]) | (owner[self.beside] == DEAD)
        beside = np.where(other, np.inf, self.between).min(axis=1)
        free = np.bincount(owner[(owner >= 0) & (beside > clear)], minlength=n_ways)
        return seen, np.maximum(LEAST_POINTS, LEAST_PER_SPACING * free)
