"""Pruning by evidence: a side end stays where points show wood that nothing else explains."""

import logging

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
    n_before = len(skeleton)
    for _ in range(MOST_ROUNDS):
        way, ends = _terminal_ways(skeleton)
        seen, wanted = _evidence(skeleton, way, len(ends), surface, spacing, noise)
        weak = np.flatnonzero(seen < wanted)
        if not len(weak):
            break
        share = (seen / wanted)[weak]
        first = {}
        for index in weak[np.lexsort((weak, share))]:  # one a junction: the other may then stay
            first.setdefault(ends[index], index)
        skeleton = skeleton.select(~np.isin(way, list(first.values())))
    logger.info("pruned %d nodes that no points of their own show", n_before - len(skeleton))
    return skeleton


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
    n_children, parent = skeleton.n_children, skeleton.parent
    way = np.full(len(skeleton), -1, dtype=np.int64)
    ends = []
    for tip in np.flatnonzero(n_children == 0):
        node, nodes = tip, []
        while node > 0 and n_children[node] <= 1:
            nodes.append(node)
            node = parent[node]
        if node == 0 and n_children[0] <= 1:
            continue  # the only axis
        way[nodes] = len(ends)
        ends.append(int(node))
    return way, ends


def _evidence(skeleton, way, n_ways, surface, spacing, noise):
    """Points of its own that each terminal way has, and how many it needs."""
    length = skeleton.edge_length
    n_steps = np.maximum(np.ceil(length / spacing).astype(np.int64), 1)
    node = np.repeat(np.arange(len(skeleton)), n_steps)
    start = np.repeat(np.cumsum(n_steps) - n_steps, n_steps)
    share = (np.arange(len(node)) - start) / n_steps[node]
    up = np.maximum(skeleton.parent, 0)
    places = skeleton.points[node] + share[:, None] * (skeleton.points[up] - skeleton.points)[node]
    radius, owner = skeleton.radius[node], way[node]
    distance, near = cKDTree(places).query(surface, k=min(NEIGHBORS, len(places)))
    outside = distance - radius[near]
    nearest = np.argmin(outside, axis=1)
    rows = np.arange(len(surface))
    own = owner[near[rows, nearest]]
    others = np.where(owner[near] == own[:, None], np.inf, outside).min(axis=1)
    clear = max(CLEAR_IN_NOISE * noise, LEAST_CLEAR * spacing)
    counts = (own >= 0) & (others > clear)
    counts &= outside[rows, nearest] < MOST_AWAY * spacing + 3 * noise
    seen = np.bincount(own[counts], minlength=n_ways).astype(np.float64)
    # the length of each way beyond the other wood, over which the points should be spread
    away, close = cKDTree(places).query(places, k=min(NEIGHBORS, len(places)))
    beside = np.where(owner[close] == owner[:, None], np.inf, away - radius[close]).min(axis=1)
    beyond = (owner >= 0) & (beside > clear)
    free = np.bincount(owner[beyond], minlength=n_ways)
    return seen, np.maximum(LEAST_POINTS, LEAST_PER_SPACING * free)
