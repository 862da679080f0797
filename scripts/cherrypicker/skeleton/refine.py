"""Repair of what the contraction does to a skeleton: bent junctions, short tips, jitter."""

import logging
from dataclasses import replace

import numba
import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.skeleton.axes import axes as find_axes
from cherrypicker.skeleton.axes import axis_of_node
from cherrypicker.skeleton.strands import (
    arc_length,
    interpolate,
    join_strands,
    nearest_on_polyline,
    split_strands,
    straight_back,
)

__all__ = [
    "refine_skeleton",
    "smooth_polyline",
    "taper_radii",
    "taper_skeleton",
]

logger = logging.getLogger(__name__)

CLEAR_OF_PARENT = 1.6  # parent radii from the parent's axis where a side axis runs undisturbed
LEAST_ANGLE_COSINE = np.cos(np.radians(12.0))
SMOOTH_NODES = 1.3  # length over which an axis is smoothed, in spacings
PULLED_WEIGHT = 0.15  # say of a node that the contraction has pulled towards a side axis
BASE_WEIGHT = 1e3
LEAST_STEP = 0.5  # of the spacing: closer nodes would hold one another too firmly
LONGEST_EXTENSION = 8  # spacings that a tip may be carried on along its surface
LEAST_EXTENSION = 0.2  # spacings
TIP_STRETCH = 5  # spacings before the tip that tell its direction and its share of points
WIDEST_BREAK = 2.0  # spacings without points that end a tip
FEWEST_AT_TIP = 4
NEAR_NODES = 6


def smooth_polyline(points, weights, stiffness, spacing=None):
    """Smooth a polyline by a penalty on its second differences (Whittaker's smoother).

    Parameters
    ----------
    points : ndarray of shape (n, 3)
    weights : ndarray of shape (n,)
    stiffness : float
        Fourth power of the length, in nodes, below which wiggles go.
    spacing : float, optional
        Usual distance of nodes: the penalty is on the change of slope, so that nodes farther
        apart hold one another less. Left out, all nodes count as evenly spaced.

    Returns
    -------
    ndarray of shape (n, 3), float64
    """
    points = np.asarray(points, dtype=np.float64)
    if len(points) < 3:
        return points.copy()
    slope = np.ones(len(points) - 1)
    if spacing is not None:
        length = np.diff(arc_length(points))
        slope = spacing / np.maximum(length, LEAST_STEP * spacing)
    return _whittaker(points, np.asarray(weights, dtype=np.float64), slope, float(stiffness))


@numba.njit(cache=True)
def _whittaker(points, weights, slope, stiffness):
    """Solve (W + stiffness D2^T D2) X = W points by a banded Cholesky factorisation."""
    n, d = points.shape
    main, first, second = weights.copy(), np.zeros(n), np.zeros(n)
    for row in range(1, n - 1):
        left, right = slope[row - 1], slope[row]
        main[row - 1] += stiffness * left * left
        main[row] += stiffness * (left + right) ** 2
        main[row + 1] += stiffness * right * right
        first[row - 1] -= stiffness * left * (left + right)  # entry (i, i + 1)
        first[row] -= stiffness * right * (left + right)
        second[row - 1] += stiffness * left * right  # entry (i, i + 2)
    found = np.empty((n, d))
    for row in range(n):  # U^T U, U kept in the same three bands
        if row > 0:
            main[row] -= first[row - 1] ** 2
            first[row] -= first[row - 1] * second[row - 1]
        if row > 1:
            main[row] -= second[row - 2] ** 2
        main[row] = np.sqrt(main[row])
        first[row] /= main[row]
        second[row] /= main[row]
        for column in range(d):
            value = weights[row] * points[row, column]
            if row > 0:
                value -= first[row - 1] * found[row - 1, column]
            if row > 1:
                value -= second[row - 2] * found[row - 2, column]
            found[row, column] = value / main[row]
    for row in range(n - 1, -1, -1):
        for column in range(d):
            value = found[row, column]
            if row < n - 1:
                value -= first[row] * found[row + 1, column]
            if row < n - 2:
                value -= second[row] * found[row + 2, column]
            found[row, column] = value / main[row]
    return found


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
    return _taper(np.asarray(radius, dtype=np.float64), np.asarray(weights, dtype=np.float64))


@numba.njit(cache=True)
def _taper(radius, weights):
    """Running median of five, then the pooled means of neighbours that grow outwards."""
    n = len(radius)
    half = min(5, n - (n + 1) % 2) // 2
    mean, weight, count = np.empty(n), np.empty(n), np.zeros(n, dtype=np.int64)
    around, n_blocks = np.empty(2 * half + 1), 0
    for row in range(n):
        for step in range(-half, half + 1):
            around[step + half] = radius[min(max(row + step, 0), n - 1)]
        mean[n_blocks], weight[n_blocks], count[n_blocks] = np.median(around), weights[row], 1
        n_blocks += 1
        while n_blocks > 1 and mean[n_blocks - 1] > mean[n_blocks - 2]:
            last, before = n_blocks - 1, n_blocks - 2
            total = weight[before] + weight[last]
            mean[before] = (weight[before] * mean[before] + weight[last] * mean[last]) / total
            weight[before] = total
            count[before] += count[last]
            n_blocks -= 1
    tapered, row = np.empty(n), 0
    for block in range(n_blocks):
        tapered[row : row + count[block]] = mean[block]
        row += count[block]
    return tapered


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


def refine_skeleton(skeleton, surface, spacing, noise=0.0):
    """Straighten junctions, smooth axes, carry tips and the foot on to the end of the surface.

    Parameters
    ----------
    skeleton : Skeleton
        With radii, nodes about `spacing` apart.
    surface : ndarray of shape (n_points, 3)
        Wood points of the original cloud.
    spacing : float
    noise : float, default 0
        Standard deviation of the surface points around the wood.

    Returns
    -------
    Skeleton
        Evenly sampled; radii interpolated from the old ones, to be fitted anew.
    """
    strands = split_strands(skeleton)
    own_points = _points_by_axis(skeleton, surface)
    attached = [[] for _ in strands]
    for index, strand in enumerate(strands):
        if strand.parent >= 0:
            attached[strand.parent].append(index)
    for index, strand in enumerate(strands):
        if strand.parent >= 0:
            _attach(strand, strands[strand.parent], spacing)
        _smooth(strand, [strands[child] for child in attached[index]], spacing)
        _follow_surface(strand, surface[own_points[index]], spacing, noise)
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
    s = arc_length(strand.points)
    first = int(clear[0]) if len(clear) else len(strand.points) - 1
    start = strand.points[0]
    while first > 1:  # what is left out must lie along the straight way, or inside the parent
        left_out = strand.points[1:first][distance[1:first] > R[1:first]]
        if not len(left_out) or _off_line(left_out, start, strand.points[first]) <= spacing:
            break
        first -= 1
    reach = max(2.0 * R[first], 5 * spacing)
    run = strand.points[first:][s[first:] - s[first] <= reach]
    place = _meet(parent, strand.points[first], run, at[0], R[first], spacing)
    start = interpolate(parent.points, parent.points, np.array([place]))[0]
    bridged = bool(strand.gap[: first + 1].any())
    n_between = max(1, int(round(np.linalg.norm(strand.points[first] - start) / spacing)))
    n_between = 1 if bridged else n_between  # nothing was seen there: no nodes
    share = np.linspace(0, 1, n_between + 1)[:-1, None]
    bridge = start + share * (strand.points[first] - start)
    strand.at = float(place)
    strand.points = np.vstack([bridge, strand.points[first:]])
    for name, fill in (("radius", strand.radius[first]), ("label", strand.label[first])):
        values = getattr(strand, name)[first:]
        setattr(strand, name, np.concatenate([np.full(n_between, fill), values]))
    strand.gap = np.concatenate([np.full(n_between, bridged), strand.gap[first:]]).astype(int)


def _off_line(points, start, end):
    """Largest distance of points from the line through two others."""
    direction = (end - start) / max(np.linalg.norm(end - start), 1e-12)
    offset = points - start
    return float(np.linalg.norm(offset - np.outer(offset @ direction, direction), axis=1).max())


def _meet(parent, end, run, at_now, R, spacing):
    """Arc length on the parent's axis that the side axis's straight continuation meets."""
    fallback = float(nearest_on_polyline(parent.points, end[None])[0][0])
    fallback = float(
        np.clip(at_now, fallback - 4 * R - 2 * spacing, fallback + 4 * R + 2 * spacing)
    )
    if len(run) < 3:
        return fallback
    place, cosine = straight_back(parent.points, run, at_now, 4 * R + 4 * spacing, R + spacing)
    return float(place) if np.isfinite(place) and cosine < LEAST_ANGLE_COSINE else fallback


def _smooth(strand, sides, spacing):
    """Smooth an axis; nodes near side axes, pulled towards them, have little say."""
    s = arc_length(strand.points)
    weights = np.ones(len(s))
    for side in sides:
        thin = sorted(side.radius[:3].tolist())[len(side.radius[:3]) // 2] / max(
            float(interpolate(strand.points, strand.radius, np.array([side.at]))[0]), 1e-9
        )
        if thin > 0.25:
            reach = 1.5 * float(np.interp(side.at, s, strand.radius)) + spacing
            weights[np.abs(s - side.at) <= reach] = PULLED_WEIGHT
    if strand.parent >= 0:
        weights[0] = BASE_WEIGHT
    weights[-1] = max(weights[-1], 0.5)
    nodes = max(SMOOTH_NODES, 0.5 * _median(strand.radius) / spacing)
    strand.points = smooth_polyline(strand.points, weights, nodes**4, spacing)


@numba.njit(cache=True)
def _median(values):
    return np.median(values)


def _points_by_axis(skeleton, surface):
    """Rows of the surface points that lie nearest to each axis's wood, a list of int64 arrays."""
    axis_list = find_axes(skeleton)
    owner = axis_of_node(skeleton, axis_list)
    n_near = min(NEAR_NODES, len(skeleton))
    distance, near = cKDTree(skeleton.points).query(surface, k=n_near)
    distance, near = distance.reshape(-1, n_near), near.reshape(-1, n_near)
    best = np.argmin(distance - skeleton.radius[near], axis=1)
    axis = owner[near[np.arange(len(surface)), best]]
    order = np.argsort(axis, kind="stable")
    return np.split(order, np.searchsorted(axis[order], np.arange(1, len(axis_list))))


def _follow_surface(strand, points, spacing, noise):
    """Carry the tip on to where the axis's own points end: contraction shortens tips.

    As many points as lie beyond the tip are worth so much length as they take before it, whatever
    the noise does to the outermost of them.
    """
    s = arc_length(strand.points)
    if len(s) < 3 or len(points) < FEWEST_AT_TIP:
        return
    before = max(0, int(np.searchsorted(s, s[-1] - TIP_STRETCH * spacing)) - 1)
    before = min(before, len(s) - 3)
    direction = strand.points[-1] - strand.points[before]
    stretch = np.linalg.norm(direction)
    if stretch <= 0:
        return
    direction /= stretch
    aside = max(2 * _median(strand.radius[before:]), 3 * noise, spacing)
    beyond, n_before = _beyond_tip(points, strand.points[-1], direction, stretch, aside, spacing)
    if n_before < FEWEST_AT_TIP or not len(beyond):
        return
    reach = min(len(beyond) / n_before * stretch, beyond[-1], LONGEST_EXTENSION * spacing)
    n = int(np.ceil(reach / spacing - 0.5))
    if reach < LEAST_EXTENSION * spacing:
        return
    steps = reach * (np.arange(max(n, 1)) + 1) / max(n, 1)
    added = strand.points[-1] + steps[:, None] * direction
    n = len(added)
    strand.points = np.vstack([strand.points, added])
    strand.radius = np.concatenate([strand.radius, np.full(n, strand.radius[-1])])
    strand.label = np.concatenate([strand.label, np.full(n, strand.label[-1])])
    strand.gap = np.concatenate([strand.gap, np.zeros(n, dtype=int)])


@numba.njit(cache=True)
def _beyond_tip(points, tip, direction, stretch, aside, spacing):
    """How far beyond a tip its points lie, up to the first break, and how many lie before it."""
    beyond, n_beyond, n_before = np.empty(len(points)), 0, 0
    for row in range(len(points)):
        x, y, z = points[row, 0] - tip[0], points[row, 1] - tip[1], points[row, 2] - tip[2]
        along = x * direction[0] + y * direction[1] + z * direction[2]
        if x * x + y * y + z * z - along * along > aside * aside or along <= -stretch:
            continue
        if along > 0:
            beyond[n_beyond] = along
            n_beyond += 1
        else:
            n_before += 1
    beyond = np.sort(beyond[:n_beyond])
    last = 0.0
    for row in range(n_beyond):
        if beyond[row] - last > WIDEST_BREAK * spacing:
            return beyond[:row], n_before
        last = beyond[row]
    return beyond, n_before


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
