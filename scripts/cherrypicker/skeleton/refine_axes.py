"""Axis after axis, parents first: junctions straightened, jitter smoothed, ends carried on.

All compiled: a tree has hundreds of axes of a few dozen nodes each.
"""

import numba
import numpy as np

from cherrypicker.skeleton.polylines import (
    along_polyline,
    between,
    meet_backwards,
    nearest_places,
)
from cherrypicker.skeleton.strands import Strands, grown, side_rows

__all__ = ["refine_strands", "smooth"]

CLEAR_OF_PARENT = 1.6  # parent radii from the parent's axis where a side axis runs undisturbed
LEAST_ANGLE_COSINE = np.cos(np.radians(12.0))
SMOOTH_NODES = 1.3  # length over which an axis is smoothed, in spacings
PULLED_WEIGHT = 0.15  # say of a node that the contraction has pulled towards a side axis
BASE_WEIGHT = 1e3
THICK_SIDE = 0.25  # of the axis's radius: thinner side axes pull nothing
LEAST_STEP = 0.5  # of the spacing: closer nodes would hold one another too firmly
LONGEST_EXTENSION = 8  # spacings that a tip may be carried on along its surface
LEAST_EXTENSION = 0.2  # spacings
TIP_STRETCH = 5  # spacings before the tip that tell its direction and its share of points
WIDEST_BREAK = 2.0  # spacings without points that end a tip
FEWEST_AT_TIP = 4


def refine_strands(strands, surface, order, first, spacing, noise):
    """Straighten the starts of strands, smooth them and carry their ends on along the surface.

    Parameters
    ----------
    strands : Strands
    surface : ndarray of shape (n_points, 3), float64
    order, first : ndarray of int64
        The points ``surface[order[first[i]:first[i + 1]]]`` belong to strand i.
    spacing, noise : float

    Returns
    -------
    Strands
    """
    columns = np.column_stack([strands.points, strands.radius])
    kinds = np.stack([strands.label, strands.gap], axis=1)
    tree = strands.start, strands.parent, strands.at
    values, kinds, start, at = _refined(
        columns, kinds, tree, surface, order, first, float(spacing), float(noise)
    )
    return Strands(
        np.ascontiguousarray(values[:, :3]),
        values[:, 3].copy(),
        kinds[:, 0].copy(),
        kinds[:, 1].copy(),
        start,
        strands.parent,
        at,
    )


@numba.njit(cache=True)
def _refined(columns, kinds, tree, surface, order, first, spacing, noise):
    """`refine_strands` on columns x, y, z, radius and label, gap."""
    start, parent, at = tree
    place = at.copy()
    side_start, side = side_rows(parent)
    new_start = np.zeros(len(start), dtype=np.int64)
    values, marks = np.empty_like(columns), np.empty_like(kinds)
    for index in range(len(parent)):
        a, b = start[index], start[index + 1]
        line, mark = columns[a:b], kinds[a:b]
        if index:
            low, high = new_start[parent[index]], new_start[parent[index] + 1]
            line, mark, place[index] = _attached(line, mark, values[low:high], spacing)
        sides = side[side_start[index] : side_start[index + 1]]
        weights = _weights(line, columns, start, at, sides, spacing)
        if index:
            weights[0] = BASE_WEIGHT
        nodes = max(SMOOTH_NODES, 0.5 * np.median(line[:, 3]) / spacing)
        points = smooth(np.ascontiguousarray(line[:, :3]), weights, nodes**4, spacing)
        own = surface[order[first[index] : first[index + 1]]]
        ahead = _beyond_the_tip(points, line[:, 3], own, spacing, noise)
        foot = np.empty((0, 3))
        if index == 0:
            foot = _below_the_foot(points, line[:, 3], len(points) + len(ahead), surface, spacing)
        low, below = new_start[index], len(foot)
        top = low + below + len(points)
        new_start[index + 1] = top + len(ahead)
        values, marks = grown(values, top + len(ahead)), grown(marks, top + len(ahead))
        for row in range(low, top + len(ahead)):
            near = min(max(row - low - below, 0), len(points) - 1)
            values[row, 3], marks[row, 0], marks[row, 1] = line[near, 3], mark[near, 0], 0
        values[low : low + below, :3], values[low + below : top, :3] = foot, points
        values[top : top + len(ahead), :3] = ahead
        marks[low + below : top, 1] = mark[:, 1]
    total = new_start[len(parent)]
    return values[:total], marks[:total], new_start, place


@numba.njit(cache=True)
def _attached(line, mark, parent, spacing):
    """Let a side axis run straight from where it is clear of its parent to the parent's axis.

    The contraction pulls the first stretch of a side axis towards its parent and bends it; beyond
    `CLEAR_OF_PARENT` radii it runs as it grew. Returns its columns and its place on the parent.
    """
    points, parent_points = line[:, :3].copy(), parent[:, :3].copy()
    along = along_polyline(parent_points)
    at, distance = nearest_places(parent_points, points)
    R = between(along, parent[:, 3:].copy(), at)[:, 0]
    last = len(points) - 1
    first = last
    for row in range(last, 0, -1):
        if distance[row] > CLEAR_OF_PARENT * R[row] + spacing:
            first = row
    while first > 1:  # what is left out must lie along the straight way, or inside the parent
        if _off_line(points[:first], points[first], distance > R) <= spacing:
            break
        first -= 1
    s = along_polyline(points)
    reach, end = max(2.0 * R[first], 5 * spacing), first
    while end <= last and s[end] - s[first] <= reach:
        end += 1
    place = _meet(parent_points, points[first:end], at[0], R[first], spacing)
    begin = between(along, parent_points, np.array([place]))[0]
    bridged = mark[: first + 1, 1].any()
    way = points[first] - begin
    n = max(1, int(np.rint(np.sqrt((way * way).sum()) / spacing)))
    n = 1 if bridged else n  # nothing was seen there: no nodes
    new = np.empty((n + len(line) - first, 4))
    new_mark = np.empty((len(new), 2), dtype=np.int64)
    for row in range(n):
        new[row, :3], new[row, 3] = begin + row / n * way, line[first, 3]
        new_mark[row, 0], new_mark[row, 1] = mark[first, 0], bridged
    new[n:], new_mark[n:] = line[first:], mark[first:]
    return new, new_mark, place


@numba.njit(cache=True)
def _off_line(points, end, counts):
    """Largest distance of the points that count from the line between the first and `end`."""
    way = end - points[0]
    way = way / max(np.sqrt((way * way).sum()), 1e-12)
    largest = 0.0
    for row in range(1, len(points)):
        if counts[row]:
            offset = points[row] - points[0]
            offset = offset - (offset * way).sum() * way
            largest = max(largest, np.sqrt((offset * offset).sum()))
    return largest


@numba.njit(cache=True)
def _meet(parent, run, at_now, R, spacing):
    """Arc length on the parent's axis that the side axis's straight continuation meets."""
    nearest = nearest_places(parent, run[:1])[0][0]
    slack = 4 * R + 2 * spacing
    fallback = min(max(at_now, nearest - slack), nearest + slack)
    if len(run) < 3:
        return fallback
    place, cosine = meet_backwards(parent, run, at_now, 4 * R + 4 * spacing, R + spacing)
    return place if np.isfinite(place) and cosine < LEAST_ANGLE_COSINE else fallback


@numba.njit(cache=True)
def _weights(line, columns, start, at, sides, spacing):
    """Say of the nodes of an axis when it is smoothed: little near thick side axes."""
    s = along_polyline(line[:, :3].copy())
    radius = line[:, 3:].copy()
    weights = np.ones(len(s))
    for index in sides:
        thin = np.sort(columns[start[index] : min(start[index] + 3, start[index + 1]), 3])
        own = between(s, radius, at[index : index + 1])[0, 0]
        if thin[len(thin) // 2] > THICK_SIDE * max(own, 1e-9):
            reach = 1.5 * own + spacing
            for row in range(len(s)):
                if abs(s[row] - at[index]) <= reach:
                    weights[row] = PULLED_WEIGHT
    weights[-1] = max(weights[-1], 0.5)
    return weights


@numba.njit(cache=True)
def smooth(points, weights, stiffness, spacing):
    """Smooth a polyline by a penalty on the change of its slope, nodes `spacing` apart or more."""
    if len(points) < 3:
        return points.copy()
    slope = spacing / np.maximum(np.diff(along_polyline(points)), LEAST_STEP * spacing)
    return whittaker(points, weights, slope, stiffness)


@numba.njit(cache=True)
def whittaker(points, weights, slope, stiffness):
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


@numba.njit(cache=True)
def _beyond_the_tip(points, radius, surface, spacing, noise):
    """Nodes from the tip on to where the axis's own points end: contraction shortens tips.

    As many points as lie beyond the tip are worth so much length as they take before it, whatever
    the noise does to the outermost of them.
    """
    nothing, last = np.empty((0, 3)), len(points) - 1
    if last < 2 or len(surface) < FEWEST_AT_TIP:
        return nothing
    s = along_polyline(points)
    before = max(0, np.searchsorted(s, s[last] - TIP_STRETCH * spacing) - 1)
    before = min(before, last - 2)
    direction = points[last] - points[before]
    stretch = np.sqrt((direction * direction).sum())
    if stretch <= 0:
        return nothing
    direction /= stretch
    aside = max(2 * np.median(radius[before:]), 3 * noise, spacing)
    beyond, n_before = _points_around_tip(surface, points[last], direction, stretch, aside, spacing)
    if n_before < FEWEST_AT_TIP or not len(beyond):
        return nothing
    reach = min(len(beyond) / n_before * stretch, beyond[-1], LONGEST_EXTENSION * spacing)
    if reach < LEAST_EXTENSION * spacing:
        return nothing
    n = max(int(np.ceil(reach / spacing - 0.5)), 1)
    steps = reach * (np.arange(n) + 1) / n
    return points[last] + steps.reshape(-1, 1) * direction


@numba.njit(cache=True)
def _points_around_tip(points, tip, direction, stretch, aside, spacing):
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


@numba.njit(cache=True)
def _below_the_foot(points, radius, n_nodes, surface, spacing):
    """Nodes that carry the trunk's foot on, straight, to the lowest points of its surface."""
    nothing = np.empty((0, 3))
    s = along_polyline(points)
    thick = np.median(radius[: max(3, n_nodes // 20)])
    n_run = min(max(3, np.searchsorted(s, max(4 * thick, 6 * spacing))), len(points))
    direction = points[0] - points[n_run - 1]
    length = np.sqrt((direction * direction).sum())
    if length == 0:
        return nothing
    direction /= length
    below, n_below = np.empty(len(surface)), 0
    for row in range(len(surface)):
        x = surface[row, 0] - points[0, 0]
        y = surface[row, 1] - points[0, 1]
        z = surface[row, 2] - points[0, 2]
        along = x * direction[0] + y * direction[1] + z * direction[2]
        if 0 < along < 6 * thick + 10 * spacing:
            x, y, z = x - along * direction[0], y - along * direction[1], z - along * direction[2]
            if x * x + y * y + z * z <= 4 * thick * thick:
                below[n_below] = along
                n_below += 1
    if n_below < 5:
        return nothing
    n_steps = int(np.quantile(below[:n_below], 0.98) // spacing)
    steps = spacing * np.arange(n_steps, 0, -1)
    return points[0] + steps.reshape(-1, 1) * direction
