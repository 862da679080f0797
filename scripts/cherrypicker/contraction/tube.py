"""The stem as one tapered tube: its axis past holes, fitted to the surface with smooth bends."""

import logging

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter
from scipy.sparse import coo_matrix, diags
from scipy.sparse.csgraph import dijkstra
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from cherrypicker.geometry.neighbors import components, knn_edges, sparse_graph
from cherrypicker.wood.gaps import STEM_GAP_M

__all__ = ["fit_tube", "recentre_stem"]

logger = logging.getLogger(__name__)

N_NEIGHBORS = 8
FEWEST_POINTS = 60
FEWEST_NODES = 4
N_ROUNDS = 6
STIFFNESS = 1.0  # bends shorter than this many radii are smoothed
RADIUS_STIFFNESS = 0.01  # of that: the foot of a stem flares
TUKEY = 4.0  # residuals beyond this many spreads do not count
MOST_SPREAD = 0.35  # of the radius: what is rougher is no tube
SLACK_M = 0.01
MOST_CARRIED = 0.8  # of the radius
N_SECTORS = 12
MOST_PROLONGED = 10  # nodes
STEP_M = 0.02
FEWEST_IN_CELL = 4
N_RECENT = 6  # cells that tell where the stem goes and how thick it is
GATE_IN_RADII, MOST_GROWTH = 2.0, 1.1
MOST_GAP_M = STEM_GAP_M
MOST_WIDENING = 1.6


def recentre_stem(points, contracted, base, *, spacing):
    """Move the contracted points of a stem onto the axis of the tube that fits its surface.

    Holes pull a contracted surface towards its remaining side; the circles of a tube do not mind
    what is missing from them. Points that do not fit the tube, or that it would carry far from
    where they contracted to, stay.

    Parameters
    ----------
    points, contracted : ndarray of shape (n_points, 3), float64
        Surface points of the stem before and after the contraction.
    base : ndarray of shape (3,)
        Foot of the stem; z up.
    spacing : float
        Distance between surface points.

    Returns
    -------
    contracted : ndarray of shape (n_points, 3), float64
    is_moved : ndarray of shape (n_points,), bool
    """
    unmoved = contracted, np.zeros(len(points), dtype=bool)
    if len(points) < FEWEST_POINTS:
        return unmoved
    nodes, is_stem = _first_axis(points, contracted, base, spacing)
    if len(nodes) < FEWEST_NODES or np.count_nonzero(is_stem) < FEWEST_POINTS:
        return unmoved
    fit = fit_tube(points[is_stem], _prolonged(points[is_stem], nodes))
    if fit is None:
        return unmoved
    nodes, radius, spread = fit
    place, foot = _project(points, nodes)
    there = np.interp(place, np.arange(len(nodes)), radius)
    rough = np.interp(place, np.arange(len(nodes)), spread)
    away = np.linalg.norm(points - foot, axis=1)
    fits = is_stem & (np.abs(away - there) <= np.maximum(TUKEY * rough, SLACK_M))
    fits &= rough <= np.maximum(MOST_SPREAD * there, 0.5 * spacing)
    fits &= place <= _last_node(radius)
    carried = np.linalg.norm(foot - contracted, axis=1)
    contracted_by = np.linalg.norm(contracted - points, axis=1)
    # between two stems lies an axis that fits both, a whole radius from either
    is_near = carried <= np.maximum(contracted_by + SLACK_M, MOST_CARRIED * there)
    fits &= is_near | _all_around(points - foot, place, nodes, radius)
    logger.info("the stem's tube takes %d of %d points", np.count_nonzero(fits), len(points))
    return np.where(fits[:, None], foot, contracted), fits


def _last_node(radius):
    """Where the tube widens again: above a fork, limbs that part look like one growing tube."""
    radius = median_filter(radius, N_RECENT, mode="nearest")
    thinnest = np.minimum.accumulate(radius)
    wider = np.flatnonzero(radius > MOST_WIDENING * thinnest)
    if not len(wider):
        return np.inf
    return int(np.flatnonzero(radius[: wider[0] + 1] == thinnest[wider[0]])[-1])


def _all_around(outward, place, nodes, radius):
    """Which points lie where the surface goes around the axis for more than half a turn."""
    n = len(nodes)
    along = np.gradient(nodes, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along).max(axis=0))])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    node = np.clip(np.rint(place).astype(np.int64), 0, n - 1)
    x = np.einsum("ij,ij->i", outward, across[node])
    y = np.einsum("ij,ij->i", outward, np.cross(along, across)[node])
    sector = ((np.arctan2(y, x) / (2 * np.pi) + 0.5) * N_SECTORS).astype(np.int64) % N_SECTORS
    is_filled = np.zeros((n, N_SECTORS), dtype=np.int64)
    is_filled[node, sector] = 1
    step = float(np.linalg.norm(nodes[1] - nodes[0]))
    reach = 1 + int(float(np.median(radius)) / step)
    is_filled = maximum_filter1d(is_filled, 2 * reach + 1, axis=0, mode="nearest")
    return (is_filled.sum(axis=1) > N_SECTORS // 2)[node]


def _first_axis(points, contracted, base, spacing):
    """Means of the contracted points in steps of the way from the foot along the surface, and
    which points they are made of.
    """
    edges = knn_edges(points, N_NEIGHBORS)
    member, _ = components(len(points), edges)
    # from all around the foot: from a single point the first steps would lie to one side of it
    foot = np.flatnonzero(points[:, 2] <= max(base[2], points[:, 2].min() + 2 * spacing))
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    graph = sparse_graph(len(points), edges, length)
    way = dijkstra(graph, directed=False, indices=foot, min_only=True)
    loose = np.flatnonzero(~np.isfinite(way))
    if len(loose):  # beyond a gap: as far as the straight way from the nearest reached point
        reached = np.flatnonzero(np.isfinite(way))
        for piece in np.unique(member[loose]):
            rows = loose[member[loose] == piece]
            distance, nearest = cKDTree(points[reached]).query(points[rows])
            entry = int(np.argmin(distance))
            way[rows] = (
                way[reached[nearest[entry]]]
                + distance[entry]
                + np.linalg.norm(points[rows] - points[rows[entry]], axis=1)
            )
    step = max(2.0 * spacing, STEP_M)
    is_stem, nodes = _follow(points, contracted, (way / step).astype(np.int64), step)
    return _resampled(nodes, step), is_stem


def _follow(points, contracted, cell, step):
    """Follow the stem from cell to cell of the way from its foot, past branches taken for stem.

    Points count within two radii of where the cells below lead to; the radius may grow little.

    Returns
    -------
    is_stem : ndarray of shape (n_points,), bool
    nodes : ndarray of shape (n_nodes, 3)
    """
    order = np.argsort(cell, kind="stable")
    cells = np.split(order, np.cumsum(np.bincount(cell))[:-1])
    is_stem, nodes, at, radii = np.zeros(len(points), dtype=bool), [], [], []
    for number, in_cell in enumerate(cells):
        rows = in_cell
        if nodes:
            if (number - at[-1]) * step > MOST_GAP_M:
                break
            radius = float(np.median(radii[-N_RECENT:]))
            ahead = nodes[-1] + (number - at[-1]) * _heading(nodes, at)
            away = np.linalg.norm(points[rows] - ahead, axis=1)
            rows = rows[away <= GATE_IN_RADII * radius + step]
        if len(rows) < FEWEST_IN_CELL:
            continue
        is_stem[rows] = True
        centre = contracted[rows].mean(axis=0)
        radius = float(np.median(np.linalg.norm(points[rows] - centre, axis=1)))
        if radii:
            radius = min(radius, MOST_GROWTH * float(np.median(radii[-N_RECENT:])))
        nodes.append(centre)
        at.append(number)
        radii.append(radius)
    return is_stem, np.array(nodes).reshape(-1, 3)


def _heading(nodes, at):
    """Mean move from cell to cell over the last nodes; none where they are too few."""
    first = max(0, len(nodes) - N_RECENT)
    if len(nodes) - first < 3:
        return np.zeros(3)
    return (nodes[-1] - nodes[first]) / (at[-1] - at[first])


def _resampled(nodes, step):
    """A polyline with smoothed corners and nodes every `step`."""
    for _ in range(2):
        nodes = np.vstack([nodes[:1], (nodes[:-2] + 2 * nodes[1:-1] + nodes[2:]) / 4, nodes[-1:]])
    steps = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    if way[-1] < step:
        return nodes[:1]
    at = np.linspace(0.0, way[-1], int(way[-1] / step) + 1)
    return np.stack([np.interp(at, way, column) for column in nodes.T], axis=1)


def _prolonged(points, nodes):
    """The polyline with straight ends as long as the points reach beyond it (a contracted tube
    is shorter than its surface by about a radius at either end).
    """
    place, _ = _project(points, nodes)
    before = np.arange(min(int(np.ceil(-place.min())), MOST_PROLONGED), 0, -1)[:, None]
    after = np.arange(1, 1 + min(int(np.ceil(place.max() - len(nodes) + 1)), MOST_PROLONGED))
    first = nodes[0] + before * (nodes[0] - nodes[1])
    last = nodes[-1] + after[:, None] * (nodes[-1] - nodes[-2])
    return np.vstack([first, nodes, last])


def _project(points, nodes):
    """Nearest place on a polyline, its ends prolonged.

    Returns
    -------
    place : ndarray of shape (n_points,), float64
        Node number, its fraction along the segment; beyond the ends below 0 or above n - 1.
    foot : ndarray of shape (n_points, 3), float64
    """
    last = len(nodes) - 2
    nearest = cKDTree(nodes).query(points)[1]
    best, place = np.full(len(points), np.inf), np.zeros(len(points))
    foot = np.empty_like(points)
    for segment in (np.maximum(nearest - 1, 0), np.minimum(nearest, last)):
        start, along = nodes[segment], nodes[segment + 1] - nodes[segment]
        share = np.einsum("ij,ij->i", points - start, along) / np.einsum("ij,ij->i", along, along)
        share = np.clip(
            share, np.where(segment == 0, -np.inf, 0.0), np.where(segment == last, np.inf, 1.0)
        )
        spot = start + share[:, None] * along
        distance = np.linalg.norm(points - spot, axis=1)
        better = distance < best
        best = np.where(better, distance, best)
        place = np.where(better, segment + share, place)
        foot[better] = spot[better]
    return place, foot


def fit_tube(points, nodes):
    """Fit a tube of varying radius around a polyline to surface points.

    Gauss-Newton on the distance of each point from the axis less the radius there, robust (Tukey),
    with second differences of the axis and of the radius held small.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    nodes : ndarray of shape (n_nodes, 3), float64
        First axis, evenly spaced nodes.

    Returns
    -------
    nodes : ndarray of shape (n_nodes, 3), float64
    radius : ndarray of shape (n_nodes,), float64
    spread : ndarray of shape (n_nodes,), float64
        Robust spread of the residuals around each node.
        None instead of all three where the fit fails.
    """
    n = len(nodes)
    step = float(np.linalg.norm(nodes[1] - nodes[0]))
    place, foot = _project(points, nodes)
    radius = _node_medians(place, np.linalg.norm(points - foot, axis=1), n)
    for _ in range(N_ROUNDS):
        place, foot = _project(points, nodes)
        offset = points - foot
        away = np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
        low = np.clip(place.astype(np.int64), 0, n - 2)
        share = np.clip(place - low, 0.0, 1.0)
        residual = away - ((1 - share) * radius[low] + share * radius[low + 1])
        spread = _node_medians(place, np.abs(residual), n) * 1.4826
        scale = np.maximum((1 - share) * spread[low] + share * spread[low + 1], 1e-4)
        weight = np.square(np.maximum(1 - np.square(residual / (TUKEY * scale)), 0))
        change = _solve(low, share, offset / away[:, None], residual, weight, nodes, radius, step)
        if not np.isfinite(change).all():
            return None
        limit = 0.5 * float(np.median(radius))
        nodes = nodes + np.clip(change[:, :3], -limit, limit)
        radius = np.maximum(radius + np.clip(change[:, 3], -limit, limit), 1e-4)
    return nodes, radius, spread


def _solve(low, share, outward, residual, weight, nodes, radius, step):
    """One Gauss-Newton step: changes of the nodes and radii, (n_nodes, 4)."""
    n = len(nodes)
    rows = np.arange(len(low))
    columns, values = [], []
    for end, part in ((low, 1 - share), (low + 1, share)):
        for axis in range(3):
            columns.append(4 * end + axis)
            values.append(part * outward[:, axis])
        columns.append(4 * end + 3)
        values.append(part)
    shape = (len(low), 4 * n)
    J = coo_matrix((np.concatenate(values), (np.tile(rows, 8), np.concatenate(columns))), shape)
    J = J.tocsr()
    per_node = max(float(weight.sum()) / n, 1.0)
    stiff = per_node * max(STIFFNESS * float(np.median(radius)) / step, 1.0) ** 4
    second = diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n))
    bends = _for_each_unknown(second, n)
    firm = np.where(np.arange(4 * (n - 2)) // (n - 2) == 3, RADIUS_STIFFNESS * stiff, stiff)
    state = np.concatenate([nodes, radius[:, None]], axis=1).ravel()
    A = (
        J.T @ diags(weight) @ J
        + bends.T @ diags(firm) @ bends
        + diags(np.full(4 * n, 1e-3 * per_node))
    )
    b = J.T @ (weight * residual) - bends.T @ (firm * (bends @ state))
    return splu(A.tocsc()).solve(b).reshape(n, 4)


def _for_each_unknown(matrix, n):
    """The same operator on x, y, z and radius of nodes stored one after the other."""
    matrix = matrix.tocoo()
    m = matrix.shape[0]
    rows = np.concatenate([m * part + matrix.row for part in range(4)])
    columns = np.concatenate([4 * matrix.col + part for part in range(4)])
    return coo_matrix((np.tile(matrix.data, 4), (rows, columns)), shape=(4 * m, 4 * n)).tocsr()


def _node_medians(place, values, n):
    """Median of the values nearest to each node; nodes without any take their neighbours'."""
    node = np.clip(np.rint(place).astype(np.int64), 0, n - 1)
    order = np.lexsort((values, node))
    count = np.bincount(node, minlength=n)
    first = np.cumsum(count) - count
    filled = np.flatnonzero(count >= 3)
    if not len(filled):
        return np.full(n, float(np.median(values)))
    medians = values[order[first[filled] + count[filled] // 2]]
    return np.interp(np.arange(n), filled, medians)
