"""Radii of skeleton nodes from the original surface points."""

import logging

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["assign_surface", "fit_circle", "fit_radii", "local_tangents"]

logger = logging.getLogger(__name__)

FEWEST_POINTS = 5
ARC_SECTORS = 24


def local_tangents(skeleton, reach):
    """Direction of the skeleton at each node, from the nodes within `reach` along its own axis.

    Parameters
    ----------
    skeleton : Skeleton
    reach : ndarray of shape (n_nodes,) or float
        How far to look each way, in the skeleton's unit.

    Returns
    -------
    ndarray of shape (n_nodes, 3), float64
        Unit vectors, from the root outwards.
    """
    reach = np.broadcast_to(np.asarray(reach, dtype=np.float64), (len(skeleton),))
    ahead_length = skeleton.reach()
    length, parent, points = skeleton.edge_length, skeleton.parent, skeleton.points
    heir = np.full(len(skeleton), -1, dtype=np.int64)
    for node in range(len(skeleton) - 1, 0, -1):
        above = parent[node]
        best = heir[above]
        if best < 0 or ahead_length[node] + length[node] > ahead_length[best] + length[best]:
            heir[above] = node
    tangents = np.empty((len(skeleton), 3))
    for node in range(len(skeleton)):
        back, travelled = node, 0.0
        while parent[back] >= 0 and travelled < reach[node]:
            if back != node and heir[parent[back]] != back:
                break  # beyond its own axis's base: another direction
            travelled += length[back]
            back = parent[back]
        front, travelled = node, 0.0
        while heir[front] >= 0 and travelled < reach[node]:
            front = heir[front]
            travelled += length[front]
        tangents[node] = points[front] - points[back]
    norm = np.linalg.norm(tangents, axis=1)
    tangents[norm == 0] = (0.0, 0.0, 1.0)
    return tangents / np.where(norm > 0, norm, 1.0)[:, None]


def assign_surface(skeleton, surface, step):
    """Nearest place on the skeleton's edges for each surface point.

    Parameters
    ----------
    skeleton : Skeleton
    surface : ndarray of shape (n_points, 3)
    step : float
        Edges are sampled at this distance.

    Returns
    -------
    node : ndarray of shape (n_points,), int64
        Nearer end of the nearest edge.
    distance : ndarray of shape (n_points,), float64
        Distance to the sampled edges.
    """
    length, parent = skeleton.edge_length, skeleton.parent
    n_steps = np.maximum(1, np.ceil(length / step).astype(np.int64))
    n_steps[0] = 1
    node = np.repeat(np.arange(len(skeleton)), n_steps)
    first = np.repeat(np.cumsum(n_steps) - n_steps, n_steps)
    share = (np.arange(len(node)) - first) / n_steps[node]  # 0 at the node, towards 1 at its parent
    above = np.where(parent[node] >= 0, parent[node], 0)
    places = skeleton.points[node] + share[:, None] * (
        skeleton.points[above] - skeleton.points[node]
    )
    owner = np.where(share <= 0.5, node, above)
    distance, nearest = cKDTree(places).query(surface, workers=1)
    return owner[nearest], distance


def fit_circle(xy, weights=None):
    """Algebraic least-squares circle (Pratt's constraint is not needed at arcs this wide).

    Parameters
    ----------
    xy : ndarray of shape (n_points, 2)
    weights : ndarray of shape (n_points,), optional

    Returns
    -------
    centre : ndarray of shape (2,), float64
    radius : float
        NaN where the points lie on a line.
    """
    w = np.ones(len(xy)) if weights is None else weights
    shift = np.average(xy, axis=0, weights=w)
    local = xy - shift
    A = np.column_stack([2 * local, np.ones(len(xy))]) * np.sqrt(w)[:, None]
    b = np.square(local).sum(axis=1) * np.sqrt(w)
    normal = A.T @ A
    scale = np.trace(normal[:2, :2])
    if scale <= 0 or abs(np.linalg.det(normal[:2, :2])) < 1e-8 * scale**2:
        return shift, np.nan
    a, c, d = np.linalg.solve(normal, A.T @ b)
    return shift + (a, c), float(np.sqrt(max(d + a * a + c * c, 0.0)))


def _basis(tangent):
    """Two unit vectors across a direction."""
    helper = np.eye(3)[np.argmin(np.abs(tangent))]
    u = np.cross(tangent, helper)
    u /= np.linalg.norm(u)
    return u, np.cross(tangent, u)


def _robust_circle(xy, n_rounds=8):
    """Circle with Tukey weights: outliers and a neighbour's points lose their say."""
    centre, radius = fit_circle(xy)
    for _ in range(n_rounds):
        if not np.isfinite(radius):
            break
        off = np.abs(np.linalg.norm(xy - centre, axis=1) - radius)
        limit = 4.0 * max(1.4826 * np.median(off), 1e-9)
        weights = np.square(np.clip(1 - np.square(off / limit), 0, None))
        if np.count_nonzero(weights) < FEWEST_POINTS:
            break
        centre, radius = fit_circle(xy, weights)
    return centre, radius


def _arc_deg(xy):
    """Part of the circumference that points around the origin cover, degrees."""
    angle = np.arctan2(xy[:, 1], xy[:, 0])
    sector = np.floor((angle + np.pi) / (2 * np.pi) * ARC_SECTORS).astype(np.int64) % ARC_SECTORS
    return 360.0 * len(np.unique(sector)) / ARC_SECTORS


def fit_radii(skeleton, surface, *, spacing, max_radius, least_radius=0.001, recentre=True):
    """Radius of each node, and its place on the axis, from the surface points around it.

    The points nearest to the node and its neighbours within a radius along the axis are
    projected along the axis's direction. Where they cover half the circumference, a robust circle
    gives radius and centre; else, and on wood too thin for the noise, the radius is the median
    distance to the axis. Nodes without points take the radius along their path.

    Parameters
    ----------
    skeleton : Skeleton
    surface : ndarray of shape (n_points, 3)
        Wood points of the original cloud, same frame.
    spacing : float
        Distance between nodes.
    max_radius : float
        Surface points farther than this from the skeleton are left out.
    least_radius : float, default 0.001
    recentre : bool, default True
        Move nodes to the centre of their circles.

    Returns
    -------
    Skeleton
        With `radius` and the fields ``n_points``, ``arc_deg``, ``residual``.
    """
    n_nodes = len(skeleton)
    owner, distance = assign_surface(skeleton, surface, spacing / 3)
    near = distance <= max_radius
    owner, distance, surface = owner[near], distance[near], surface[near]
    order = np.argsort(owner, kind="stable")
    start = np.searchsorted(owner[order], np.arange(n_nodes + 1))
    first_guess = _first_radii(distance[order], start, spacing)
    reach = np.clip(1.5 * first_guess, 1.5 * spacing, None)
    tangents = local_tangents(skeleton, 2 * reach)
    radius, centre = np.full(n_nodes, np.nan), skeleton.points.copy()
    n_points, arc, residual = np.zeros(n_nodes, int), np.zeros(n_nodes), np.zeros(n_nodes)
    windows = _windows(skeleton, reach)
    for node in range(n_nodes):
        rows = np.concatenate([order[start[near] : start[near + 1]] for near in windows[node]])
        if len(rows) < FEWEST_POINTS:
            continue
        u, v = _basis(tangents[node])
        offset = surface[rows] - skeleton.points[node]
        fit = _fit_node(np.stack([offset @ u, offset @ v], axis=1))
        radius[node], shift, arc[node], residual[node] = fit
        n_points[node] = len(rows)
        if recentre:
            centre[node] += shift[0] * u + shift[1] * v
    radius = np.maximum(_fill_along_paths(skeleton, radius), least_radius)
    fields = dict(skeleton.fields, n_points=n_points, arc_deg=arc, residual=residual)
    return type(skeleton)(
        centre, skeleton.parent, radius, skeleton.label, fields, skeleton.unit, skeleton.frame
    )


def _first_radii(distance, start, spacing):
    """Median distance of the points that each node owns; the spacing where there are none."""
    guess = np.full(len(start) - 1, spacing)
    for node in np.flatnonzero(np.diff(start)):
        guess[node] = np.median(distance[start[node] : start[node + 1]])
    return guess


def _windows(skeleton, reach):
    """Nodes within `reach` of each node along its path, down and up without forks."""
    length, parent, children = skeleton.edge_length, skeleton.parent, skeleton.children()
    windows = []
    for node in range(len(skeleton)):
        own = [node]
        back, travelled = node, length[node]
        while parent[back] >= 0 and travelled <= reach[node] and len(children[parent[back]]) == 1:
            back = parent[back]
            own.append(back)
            travelled += length[back]
        front, travelled = node, 0.0
        while len(children[front]) == 1:
            front = children[front][0]
            travelled += length[front]
            if travelled > reach[node]:
                break
            own.append(front)
        windows.append(own)
    return windows


def _fit_node(xy):
    """Radius, shift of the centre, covered arc and residual of one slice."""
    away = np.linalg.norm(xy, axis=1)
    simple = float(np.median(away))
    spread = float(1.4826 * np.median(np.abs(away - simple)))
    centre, radius = _robust_circle(xy) if len(xy) >= 3 * FEWEST_POINTS else (np.zeros(2), np.nan)
    if np.isfinite(radius) and radius > 0:
        arc = _arc_deg(xy - centre)
        around = np.linalg.norm(xy - centre, axis=1)
        off = float(1.4826 * np.median(np.abs(around - radius)))
        sound = arc >= 150 and radius <= 1.6 * simple and np.linalg.norm(centre) <= 1.2 * simple
        if sound and off <= 0.35 * radius and off <= 1.05 * spread:
            return radius, centre, arc, off
    return simple, np.zeros(2), _arc_deg(xy), spread


def _fill_along_paths(skeleton, radius):
    """Radii of nodes without points: from the nearest node towards the root, else above."""
    radius = radius.copy()
    known = np.isfinite(radius)
    if not known.any():
        return np.zeros(len(radius))
    for node in range(len(radius) - 1, 0, -1):  # give the parents without points a child's
        above = skeleton.parent[node]
        if np.isfinite(radius[node]) and not np.isfinite(radius[above]):
            radius[above] = radius[node]
    for node in range(1, len(radius)):
        if not np.isfinite(radius[node]):
            radius[node] = radius[skeleton.parent[node]]
    return np.where(np.isfinite(radius), radius, np.nanmedian(radius))
