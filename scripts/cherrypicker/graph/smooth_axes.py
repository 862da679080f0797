"""Axis after axis, parents first: junctions straightened, jitter smoothed, ends carried on.

All compiled: a tree has hundreds of axes of a few dozen nodes each.
"""

import numba
import numpy as np

from cherrypicker.geometry.ordering import first_not_below, median, sort_in_place
from cherrypicker.geometry.polylines import along_polyline, between, meet_backwards, nearest_places
from cherrypicker.geometry.tree_walks import child_rows
from cherrypicker.graph.polyline_tree import Strands, grown

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
FOOT_QUANTILE = 0.98  # of the points below the foot: where the trunk ends


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
    table = np.column_stack([strands.points, strands.radius, strands.label, strands.gap])
    values, start, at = _refined(
        np.ascontiguousarray(table, dtype=np.float64),
        strands.start,
        strands.parent,
        strands.at,
        surface[order],
        first,
        float(spacing),
        float(noise),
    )
    kinds = values[:, 4:].astype(np.int64)
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
def _refined(table, start, parent, at, surface, first, spacing, noise):
    """`refine_strands` on one table of the columns x, y, z, radius, label and gap."""
    place = at.copy()
    side_start, side = child_rows(parent)
    new_start = np.zeros(len(start), dtype=np.int64)
    values = np.empty((len(table), 6))
    for index in range(len(parent)):
        line = table[start[index] : start[index + 1]]
        if index:
            below = values[new_start[parent[index]] : new_start[parent[index] + 1]]
            line, place[index] = _attached(line, below, spacing)
        sides = side[side_start[index] : side_start[index + 1]]
        weights = _weights(line, table, start, at, sides, spacing)
        if index:
            weights[0] = BASE_WEIGHT
        nodes = max(SMOOTH_NODES, 0.5 * _median_radius(line) / spacing)
        points = smooth(line, weights, nodes**4, spacing)
        own = surface[first[index] : first[index + 1]]
        ahead = _beyond_the_tip(points, line, own, spacing, noise)
        n_nodes = len(points) + len(ahead)
        foot = np.empty((0, 3))
        if index == 0:
            foot = _below_the_foot(points, line, n_nodes, surface, spacing)
        low = new_start[index]
        new_start[index + 1] = low + len(foot) + n_nodes
        values = grown(values, new_start[index + 1])
        _write(values, low, foot, points, ahead, line)
    return values[: new_start[len(parent)]], new_start, place


@numba.njit(cache=True)
def _write(values, low, foot, points, ahead, line):
    """Put the nodes of an axis into the table: what carries it on is as its next node is."""
    n_foot, n_points = len(foot), len(points)
    for row in range(n_foot + n_points + len(ahead)):
        node, last = row - n_foot, n_points - 1
        near = min(max(node, 0), last)
        for column in range(3):
            if node < 0:
                values[low + row, column] = foot[row, column]
            elif node > last:
                values[low + row, column] = ahead[node - n_points, column]
            else:
                values[low + row, column] = points[node, column]
        values[low + row, 3], values[low + row, 4] = line[near, 3], line[near, 4]
        values[low + row, 5] = line[near, 5] if near == node else 0.0


@numba.njit(cache=True)
def _median_radius(line):
    """Median radius of a stretch of an axis."""
    radius = np.empty(len(line))
    for row in range(len(line)):
        radius[row] = line[row, 3]
    return median(radius)


@numba.njit(cache=True)
def _attached(line, parent, spacing):
    """Let a side axis run straight from where it is clear of its parent to the parent's axis.

    The contraction pulls the first stretch of a side axis towards its parent and bends it; beyond
    `CLEAR_OF_PARENT` radii it runs as it grew. Returns its columns and its place on the parent.
    """
    along = along_polyline(parent)
    at, distance = nearest_places(parent, line)
    R = between(along, parent, at)[:, 3]
    last = len(line) - 1
    first = last
    for row in range(last, 0, -1):
        if distance[row] > CLEAR_OF_PARENT * R[row] + spacing:
            first = row
    # what is left out must lie along the straight way, or inside the parent
    while first > 1 and _off_line(line, first, distance, R) > spacing:
        first -= 1
    s = along_polyline(line)
    reach, end = max(2.0 * R[first], 5 * spacing), first
    while end <= last and s[end] - s[first] <= reach:
        end += 1
    spot = np.empty(1)
    spot[0] = _meet(parent, line[first:end], at[0], R[first], spacing)
    begin = between(along, parent, spot)
    bridged, way = 0.0, np.empty(3)
    for row in range(first + 1):
        bridged = 1.0 if line[row, 5] != 0 else bridged
    for column in range(3):
        way[column] = line[first, column] - begin[0, column]
    n = 1
    if bridged == 0:  # else nothing was seen there: no nodes
        length = np.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
        n = max(1, int(np.rint(length / spacing)))
    new = np.empty((n + len(line) - first, 6))
    for row in range(len(new)):
        for column in range(6):
            new[row, column] = line[max(row - n, 0) + first, column]
        if row < n:
            for column in range(3):
                new[row, column] = begin[0, column] + row / n * way[column]
            new[row, 5] = bridged
    return new, spot[0]


@numba.njit(cache=True)
def _off_line(line, end, distance, R):
    """Largest distance, of points outside the parent, from the line between the first and `end`."""
    ox, oy, oz = line[0, 0], line[0, 1], line[0, 2]
    u, v, w = line[end, 0] - ox, line[end, 1] - oy, line[end, 2] - oz
    length = max(np.sqrt(u * u + v * v + w * w), 1e-12)
    u, v, w = u / length, v / length, w / length
    largest = 0.0
    for row in range(1, end):
        if distance[row] > R[row]:
            x, y, z = line[row, 0] - ox, line[row, 1] - oy, line[row, 2] - oz
            ahead = x * u + y * v + z * w
            x, y, z = x - ahead * u, y - ahead * v, z - ahead * w
            largest = max(largest, np.sqrt(x * x + y * y + z * z))
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
def _weights(line, table, start, at, sides, spacing):
    """Say of the nodes of an axis when it is smoothed: little near thick side axes."""
    s = along_polyline(line)
    weights, spot, thin = np.ones(len(s)), np.empty(1), np.empty(3)
    for index in sides:
        spot[0] = at[index]
        own = between(s, line, spot)[0, 3]
        n_thin = min(3, start[index + 1] - start[index])
        for row in range(n_thin):
            thin[row] = table[start[index] + row, 3]
        sort_in_place(thin[:n_thin])
        if thin[n_thin // 2] > THICK_SIDE * max(own, 1e-9):
            reach = 1.5 * own + spacing
            for row in range(len(s)):
                if abs(s[row] - at[index]) <= reach:
                    weights[row] = PULLED_WEIGHT
    weights[-1] = max(weights[-1], 0.5)
    return weights


@numba.njit(cache=True)
def smooth(points, weights, stiffness, spacing):
    """Smooth a polyline by a penalty on the change of its slope, nodes `spacing` apart or more.

    `points` may have further columns after x, y and z; returns an array of shape (n, 3).
    """
    n, s = len(points), along_polyline(points)
    slope = np.empty(n)
    for row in range(n - 1):
        slope[row] = spacing / max(s[row + 1] - s[row], LEAST_STEP * spacing)
    return whittaker(points, weights, slope, stiffness)


@numba.njit(cache=True)
def whittaker(points, weights, slope, stiffness):
    """Solve (W + stiffness D2^T D2) X = W points by a banded Cholesky factorisation."""
    n, d = len(points), 3
    found = np.empty((n, d))
    if n < 3:
        for row in range(n):
            for column in range(d):
                found[row, column] = points[row, column]
        return found
    main, first, second = weights.copy(), np.zeros(n), np.zeros(n)
    for row in range(1, n - 1):
        left, right = slope[row - 1], slope[row]
        main[row - 1] += stiffness * left * left
        main[row] += stiffness * (left + right) ** 2
        main[row + 1] += stiffness * right * right
        first[row - 1] -= stiffness * left * (left + right)  # entry (i, i + 1)
        first[row] -= stiffness * right * (left + right)
        second[row - 1] += stiffness * left * right  # entry (i, i + 2)
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
def _beyond_the_tip(points, line, surface, spacing, noise):
    """Nodes from the tip on to where the axis's own points end: contraction shortens tips.

    As many points as lie beyond the tip are worth so much length as they take before it, whatever
    the noise does to the outermost of them.
    """
    nothing, last = np.empty((0, 3)), len(points) - 1
    if last < 2 or len(surface) < FEWEST_AT_TIP:
        return nothing
    s = along_polyline(points)
    before = max(0, first_not_below(s, s[last] - TIP_STRETCH * spacing) - 1)
    before = min(before, last - 2)
    direction, stretch = _direction(points[before], points[last])
    if stretch <= 0:
        return nothing
    aside = max(2 * _median_radius(line[before:]), 3 * noise, spacing)
    beyond, n_beyond, n_before = _points_around_tip(
        surface, points, direction, stretch, aside, spacing
    )
    if n_before < FEWEST_AT_TIP or not n_beyond:
        return nothing
    reach = min(n_beyond / n_before * stretch, beyond[n_beyond - 1], LONGEST_EXTENSION * spacing)
    if reach < LEAST_EXTENSION * spacing:
        return nothing
    n = max(int(np.ceil(reach / spacing - 0.5)), 1)
    ahead = np.empty((n, 3))
    for row in range(n):
        for column in range(3):
            step = reach * (row + 1) / n
            ahead[row, column] = points[last, column] + step * direction[column]
    return ahead


@numba.njit(cache=True)
def _direction(begin, end):
    """Unit vector from one point to another, and their distance."""
    found = np.empty(3)
    for column in range(3):
        found[column] = end[column] - begin[column]
    length = np.sqrt(found[0] * found[0] + found[1] * found[1] + found[2] * found[2])
    for column in range(3):
        found[column] /= max(length, 1e-300)
    return found, length


@numba.njit(cache=True)
def _points_around_tip(points, line, direction, stretch, aside, spacing):
    """How far beyond a tip its points lie, in order, how many to the first break and before it."""
    beyond, n_beyond, n_before = np.empty(len(points)), 0, 0
    tip = line[len(line) - 1]
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
    sort_in_place(beyond[:n_beyond])
    last = 0.0
    for row in range(n_beyond):
        if beyond[row] - last > WIDEST_BREAK * spacing:
            return beyond, row, n_before
        last = beyond[row]
    return beyond, n_beyond, n_before


@numba.njit(cache=True)
def _below_the_foot(points, line, n_nodes, surface, spacing):
    """Nodes that carry the trunk's foot on, straight, to the lowest points of its surface."""
    nothing = np.empty((0, 3))
    s = along_polyline(points)
    thick = _median_radius(line[: max(3, n_nodes // 20)])
    n_run = min(max(3, first_not_below(s, max(4 * thick, 6 * spacing))), len(points))
    direction, length = _direction(points[n_run - 1], points[0])
    if length == 0:
        return nothing
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
    sort_in_place(below[:n_below])
    rank = FOOT_QUANTILE * (n_below - 1)
    low = int(rank)
    high = min(low + 1, n_below - 1)
    lowest = below[low] * (1 - (rank - low)) + below[high] * (rank - low)
    n_steps = int(lowest // spacing)
    foot = np.empty((n_steps, 3))
    for row in range(n_steps):
        for column in range(3):
            foot[row, column] = points[0, column] + spacing * (n_steps - row) * direction[column]
    return foot
