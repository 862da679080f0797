"""Repair of what the contraction does to a skeleton: bent junctions, short tips, spurs, jitter."""

import logging
from dataclasses import replace

import numpy as np
from scipy.linalg import solveh_banded
from scipy.optimize import isotonic_regression
from scipy.spatial import cKDTree

from cherrypicker.skeleton.axes import axes as find_axes
from cherrypicker.skeleton.strands import (
    arc_length,
    interpolate,
    join_strands,
    nearest_on_polyline,
    split_strands,
)

__all__ = [
    "prune_spurs",
    "refine_skeleton",
    "smooth_polyline",
    "taper_radii",
    "taper_skeleton",
    "trim_unsupported",
]

logger = logging.getLogger(__name__)

CLEAR_OF_PARENT = 1.6  # parent radii from the parent's axis where a side axis runs undisturbed
LEAST_ANGLE_COSINE = np.cos(np.radians(12.0))
SMOOTH_NODES = 2.5  # length over which an axis is smoothed, in spacings
PULLED_WEIGHT = 0.15  # say of a node that the contraction has pulled towards a side axis
BASE_WEIGHT = 1e3
MOST_GAP_SHARE = 0.5  # of the length of a way to a tip: more, and there is too little behind it
LEAST_BEHIND_GAP = 5  # spacings of wood behind a gap that make a branch of it all the same
LEAST_SUPPORT = 0.08
THINNEST_IN_SPACINGS = 0.3  # below, radii say little about the surface that points are sown on
LONGEST_EXTENSION = 12  # spacings that a tip may be carried on along its surface


def prune_spurs(skeleton, spacing, *, least_nodes=1.5):
    """Remove side ends that do not come out of their parent's surface.

    A way from a tip to the junction before it is a spur when it is no longer than the radius at
    the junction plus `least_nodes` spacings, or when most of it only bridges missing data (a stray
    blob, not a branch). Pruning repeats, shortest first, since a junction
    that has lost a spur may be no junction any more.

    Parameters
    ----------
    skeleton : Skeleton
        With radii.
    spacing : float
    least_nodes : float, default 1.5

    Returns
    -------
    Skeleton
    """
    length = skeleton.edge_length
    gap = skeleton.fields.get("gap", np.zeros(len(skeleton), dtype=np.int64))
    alive = np.ones(len(skeleton), dtype=bool)
    n_children = skeleton.n_children.copy()
    n_pruned = 0
    while True:
        spurs = []
        for tip in np.flatnonzero(alive & (n_children == 0)):
            way, node = [tip], skeleton.parent[tip]
            travelled = length[tip]
            while node > 0 and n_children[node] == 1:
                way.append(node)
                travelled += length[node]
                node = skeleton.parent[node]
            if node >= 0 and n_children[node] > 1:
                limit = skeleton.radius[node] + least_nodes * spacing
                bridged = length[way][gap[way] > 0].sum()
                stray = bridged > MOST_GAP_SHARE * travelled
                stray &= travelled - bridged < LEAST_BEHIND_GAP * spacing
                if travelled < limit or stray:
                    spurs.append((travelled / limit, tip, way, node))
        touched = set()
        for _, _, way, node in sorted(spurs, key=lambda spur: spur[:2]):
            if node in touched:
                continue
            touched.add(node)
            alive[way] = False
            n_children[node] -= 1
            n_pruned += 1
        if not touched:
            break
    logger.info("pruned %d spurs", n_pruned)
    return skeleton.select(alive)


def trim_unsupported(skeleton, spacing, *, least_support=LEAST_SUPPORT):
    """Take back tips whose surface is far thinner sown with points than the tree's usual.

    Stray points of a dense reconstruction hang together with the tips that they float near; a
    twig that the reconstruction shows has about the point density of thicker wood.

    Parameters
    ----------
    skeleton : Skeleton
        With radii and the field ``n_points``.
    spacing : float
    least_support : float, default 0.08
        Share of the median point density.

    Returns
    -------
    Skeleton
    """
    radius = np.maximum(skeleton.radius, THINNEST_IN_SPACINGS * spacing)
    window = 2 * np.maximum(1.5 * skeleton.radius, 1.5 * spacing)
    density = skeleton.fields["n_points"] / (2 * np.pi * radius * window)
    thin = density < least_support * np.median(density)
    alive = np.ones(len(skeleton), dtype=bool)
    n_children = skeleton.n_children
    for node in range(len(skeleton) - 1, 2, -1):  # children come after their parents
        if thin[node] and n_children[node] == 0:
            alive[node] = False
            n_children[skeleton.parent[node]] -= 1
    logger.info("trimmed %d nodes that next to no points support", np.count_nonzero(~alive))
    return skeleton.select(alive)


def smooth_polyline(points, weights, stiffness):
    """Smooth a polyline by a penalty on its second differences (Whittaker's smoother).

    Parameters
    ----------
    points : ndarray of shape (n, 3)
    weights : ndarray of shape (n,)
    stiffness : float
        Fourth power of the length, in nodes, below which wiggles go.

    Returns
    -------
    ndarray of shape (n, 3), float64
    """
    n = len(points)
    if n < 3:
        return points.copy()
    bands = np.zeros((3, n))  # upper form of W + stiffness D2^T D2
    bands[2] = weights
    bands[2, :-2] += stiffness
    bands[2, 1:-1] += 4 * stiffness
    bands[2, 2:] += stiffness
    bands[1, 1:-1] += -2 * stiffness
    bands[1, 2:] += -2 * stiffness
    bands[0, 2:] += stiffness
    return solveh_banded(bands, weights[:, None] * points)


def taper_radii(radius, weights):
    """Radii that never grow from base to tip, near the measured ones.

    Parameters
    ----------
    radius : ndarray of shape (n,)
    weights : ndarray of shape (n,)
        Positive trust in each.

    Returns
    -------
    ndarray of shape (n,), float64
    """
    window = min(5, len(radius) - (len(radius) + 1) % 2)
    if window >= 3:
        half = window // 2
        padded = np.pad(radius, half, mode="edge")
        radius = np.median(np.lib.stride_tricks.sliding_window_view(padded, window), axis=1)
    return isotonic_regression(radius, weights=weights, increasing=False).x


def taper_skeleton(skeleton):
    """Radii that never grow along an axis and never exceed the parent's at the junction.

    Nodes that the radius fit trusts more (more of the circumference, more points) weigh more.

    Parameters
    ----------
    skeleton : Skeleton
        With the fields ``n_points`` and ``arc_deg``.

    Returns
    -------
    Skeleton
    """
    trust = 1e-3 + skeleton.fields["arc_deg"] / 360 * np.sqrt(skeleton.fields["n_points"])
    trust = np.where(skeleton.n_children > 1, 0.1 * trust, trust)
    radius = skeleton.radius.copy()
    for axis in find_axes(skeleton):
        own = taper_radii(radius[axis.nodes], trust[axis.nodes])
        if axis.attach >= 0:
            own = np.minimum(own, radius[axis.attach])
        radius[axis.nodes] = own
    return replace(skeleton, radius=radius)


def refine_skeleton(skeleton, surface, spacing):
    """Straighten junctions, smooth axes, carry tips and the foot on to the end of the surface.

    Parameters
    ----------
    skeleton : Skeleton
        With radii, nodes about `spacing` apart.
    surface : ndarray of shape (n_points, 3)
        Wood points of the original cloud.
    spacing : float

    Returns
    -------
    Skeleton
        Evenly sampled; radii interpolated from the old ones, to be fitted anew.
    """
    strands = split_strands(skeleton)
    tree = cKDTree(surface)
    nodes = cKDTree(skeleton.points)
    attached = [[] for _ in strands]
    for index, strand in enumerate(strands):
        if strand.parent >= 0:
            attached[strand.parent].append(index)
    for index, strand in enumerate(strands):
        if strand.parent >= 0:
            _attach(strand, strands[strand.parent], spacing)
        _smooth(strand, [strands[child] for child in attached[index]], spacing)
        _follow_surface(strand, tree, surface, nodes, spacing)
        if strand.parent < 0:
            _reach_foot(strand, surface, spacing)
        for child in attached[index]:  # the axis has moved below its side axes
            side = strands[child]
            side.at = float(nearest_on_polyline(strand.points, side.points[1:2])[0][0])
    return join_strands(strands, spacing, unit=skeleton.unit, frame=skeleton.frame)


def _attach(strand, parent, spacing):
    """Let a side axis run straight from where it is clear of its parent to the parent's axis.

    The contraction pulls the first stretch of a side axis towards its parent and bends it; beyond
    `CLEAR_OF_PARENT` radii it runs as it grew.
    """
    at, distance = nearest_on_polyline(parent.points, strand.points)
    R = interpolate(parent.points, parent.radius, at)
    clear = np.flatnonzero(distance > CLEAR_OF_PARENT * R + spacing)
    clear = clear[clear > 0]
    first = int(clear[0]) if len(clear) else len(strand.points) - 1
    s = arc_length(strand.points)
    reach = max(2.0 * R[first], 5 * spacing)
    run = strand.points[first:][s[first:] - s[first] <= reach]
    place = _meet(parent, strand.points[first], run, at[0], R[first], spacing)
    start = interpolate(parent.points, parent.points, np.array([place]))[0]
    n_between = max(1, int(round(np.linalg.norm(strand.points[first] - start) / spacing)))
    share = np.linspace(0, 1, n_between + 1)[:-1, None]
    bridge = start + share * (strand.points[first] - start)
    strand.at = float(place)
    bridged = bool(strand.gap[: first + 1].any())
    strand.points = np.vstack([bridge, strand.points[first:]])
    for name, fill in (("radius", strand.radius[first]), ("label", strand.label[first])):
        values = getattr(strand, name)[first:]
        setattr(strand, name, np.concatenate([np.full(n_between, fill), values]))
    strand.gap = np.concatenate([np.full(n_between, bridged), strand.gap[first:]]).astype(int)


def _meet(parent, end, run, at_now, R, spacing):
    """Arc length on the parent's axis that the side axis's straight continuation meets."""
    fallback = float(nearest_on_polyline(parent.points, end[None])[0][0])
    fallback = float(
        np.clip(at_now, fallback - 4 * R - 2 * spacing, fallback + 4 * R + 2 * spacing)
    )
    if len(run) < 3:
        return fallback
    centre = run.mean(axis=0)
    direction = np.linalg.svd(run - centre, full_matrices=False)[2][0]
    direction *= 1.0 if direction @ (run[-1] - run[0]) >= 0 else -1.0
    s = arc_length(parent.points)
    window = 4 * R + 4 * spacing
    places = np.linspace(max(0.0, at_now - window), min(s[-1], at_now + window), 81)
    spots = interpolate(parent.points, parent.points, places)
    offset = spots - centre
    along = offset @ direction
    aside = np.linalg.norm(offset - along[:, None] * direction, axis=1)
    aside[along > 0] = np.inf  # only backwards
    best = int(np.argmin(aside))
    if not np.isfinite(aside[best]) or aside[best] > R + spacing:
        return fallback
    step = spots[min(best + 1, 80)] - spots[max(best - 1, 0)]
    cosine = abs(step @ direction) / max(np.linalg.norm(step), 1e-12)
    return float(places[best]) if cosine < LEAST_ANGLE_COSINE else fallback


def _smooth(strand, sides, spacing):
    """Smooth an axis; nodes near side axes, pulled towards them, have little say."""
    s = arc_length(strand.points)
    weights = np.ones(len(s))
    for side in sides:
        thin = float(np.median(side.radius[:3])) / max(
            float(interpolate(strand.points, strand.radius, np.array([side.at]))[0]), 1e-9
        )
        if thin > 0.25:
            reach = 1.5 * float(np.interp(side.at, s, strand.radius)) + spacing
            weights[np.abs(s - side.at) <= reach] = PULLED_WEIGHT
    if strand.parent >= 0:
        weights[0] = BASE_WEIGHT
    weights[-1] = max(weights[-1], 0.5)
    nodes = max(SMOOTH_NODES, 0.5 * float(np.median(strand.radius)) / spacing)
    strand.points = smooth_polyline(strand.points, weights, nodes**4)


def _follow_surface(strand, tree, surface, nodes, spacing):
    """Carry the tip on while the surface goes on ahead of it: contraction shortens tips."""
    if len(strand.points) < 3:
        return
    n_back = min(len(strand.points) - 1, 4)
    direction = strand.points[-1] - strand.points[-1 - n_back]
    direction /= max(np.linalg.norm(direction), 1e-12)
    radius = float(np.median(strand.radius[-4:]))
    reach = max(2.0 * radius, 1.2 * spacing)
    usual = len(tree.query_ball_point(strand.points[-3], reach))
    end, added = strand.points[-1], []
    for _ in range(LONGEST_EXTENSION):
        rows = tree.query_ball_point(end + direction * spacing, reach)
        ahead = surface[rows][(surface[rows] - end) @ direction > 0.5 * spacing]
        if len(ahead) < max(3, 0.1 * usual):
            break
        to_middle = ahead.mean(axis=0) - end
        direction = 0.8 * direction + 0.2 * to_middle / np.linalg.norm(to_middle)
        direction /= np.linalg.norm(direction)
        new_end = end + spacing * direction
        if added and nodes.query(new_end)[0] < 1.5 * spacing:
            break  # another axis is there already
        end = new_end
        added.append(end)
    if added:
        n = len(added)
        strand.points = np.vstack([strand.points, added])
        strand.radius = np.concatenate([strand.radius, np.full(n, strand.radius[-1])])
        strand.label = np.concatenate([strand.label, np.full(n, strand.label[-1])])
        strand.gap = np.concatenate([strand.gap, np.zeros(n, dtype=int)])


def _reach_foot(strand, surface, spacing):
    """Carry the trunk's foot on, straight, to the lowest points of its surface."""
    s = arc_length(strand.points)
    radius = float(np.median(strand.radius[: max(3, len(s) // 20)]))
    n_run = max(3, int(np.searchsorted(s, max(4 * radius, 6 * spacing))))
    run = strand.points[: min(n_run, len(s))]
    direction = run[0] - run[-1]
    norm = np.linalg.norm(direction)
    if norm == 0:
        return
    direction /= norm
    offset = surface - run[0]
    along = offset @ direction
    aside = np.linalg.norm(offset - along[:, None] * direction, axis=1)
    below = along[(aside <= 2 * radius) & (along > 0) & (along < 6 * radius + 10 * spacing)]
    if len(below) < 5:
        return
    foot = float(np.quantile(below, 0.98))
    n = int(foot // spacing)
    if n:
        added = run[0] + direction * (spacing * np.arange(n, 0, -1)[:, None])
        strand.points = np.vstack([added, strand.points])
        strand.radius = np.concatenate([np.full(n, strand.radius[0]), strand.radius])
        strand.label = np.concatenate([np.full(n, strand.label[0]), strand.label])
        strand.gap = np.concatenate([np.zeros(n, dtype=int), strand.gap])
