"""Wood that the surface shows and a skeleton lacks: short twigs that the contraction swallowed.

A contraction draws thin side wood into its parent, and pruning its crumbs takes what is left of
short twigs. The points themselves still tell: those that lie clearly outside the wood that the
skeleton explains, in a cluster that leads away from it, are a side axis. It is traced through the
cluster and set on its parent's axis where its own direction meets it.
"""

import logging

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from cherrypicker.geometry.axis_radii import assign_surface
from cherrypicker.geometry.polylines import (
    arc_length,
    interpolate,
    nearest_on_polyline,
    straight_back,
)
from cherrypicker.graph.polyline_tree import join_strands, split_strands
from cherrypicker.skeleton.axes import axis_runs, run_of_node

__all__ = ["regrow", "surface_noise"]

logger = logging.getLogger(__name__)

CLEAR_IN_NOISE = 2.0  # standard deviations outside the explained surface where a point counts
SURE_IN_NOISE = 3.0  # a cluster needs points this far outside: noise does not get there in numbers
CLEAR_IN_RADII = 0.15  # bark, flutes and ovals of thick wood are no twigs
LEAST_CLEAR = 0.4  # spacings
LEAST_POINTS, LEAST_SURE_POINTS = 10, 4
LEAST_RISE = 0.4  # share of a way's length that leads away from the explained wood: else it is it
LEAST_LENGTH = 1.0  # spacings
LEAST_DENSITY = 0.15  # of the points that thin wood of the cluster's length would have
THIN_IN_SPACINGS = 0.25  # radius of the thinnest wood, for that number
FARTHEST_START = 6.0  # spacings of bare way that a direction may bridge
DIRECTION_SPAN = 5.0  # spacings of a cluster's inner end that tell its direction
PATH_WIDTH = 1.5  # spacings around a traced way whose points are its own


def surface_noise(skeleton):
    """Robust standard deviation of the surface points around the wood, in the skeleton's unit."""
    known = skeleton.fields["n_points"] > LEAST_POINTS
    return float(np.median(skeleton.fields["residual"][known])) if known.any() else 0.0


def regrow(skeleton, surface, spacing):
    """Add side axes where surface points lead away from the wood that a skeleton explains.

    Parameters
    ----------
    skeleton : Skeleton
        With radii and the fields of `fit_radii`.
    surface : ndarray of shape (n_points, 3), float64
        Wood points of the tree.
    spacing : float
        Distance between nodes.

    Returns
    -------
    skeleton : Skeleton
        With nodes every `spacing`; new axes have a rough radius, to be fitted.
    n_added : int
    """
    noise = surface_noise(skeleton)
    owner, distance = assign_surface(skeleton, surface)
    radius = skeleton.radius[owner]
    excess = distance - radius
    least = np.maximum(CLEAR_IN_NOISE * noise, LEAST_CLEAR * spacing) + CLEAR_IN_RADII * radius
    rows = np.flatnonzero(excess > least)
    if len(rows) < LEAST_POINTS:
        return skeleton, 0
    sure = (excess > least + (SURE_IN_NOISE - CLEAR_IN_NOISE) * noise)[rows]
    clusters = _clusters(surface[rows], spacing, sure)
    density = _area_density(skeleton)
    nodes, first, *_ = axis_runs(skeleton)
    axis_of = run_of_node(nodes, first)
    strands, added = split_strands(skeleton), []
    for own, graph in clusters:
        trace = _trace(surface[rows[own]], excess[rows[own]], graph, spacing)
        if trace is None or len(own) < _expected(trace, density, spacing):
            continue
        nodes, first = trace
        parent = int(axis_of[owner[rows[own[first]]]])
        strand = _set_on(strands, parent, nodes, spacing, noise)
        if strand is not None:
            added.append(strand)
    logger.info("%d side axes added that points show, of %d clusters", len(added), len(clusters))
    strands = strands.with_more(added)
    skeleton = join_strands(strands, spacing, unit=skeleton.unit, frame=skeleton.frame)
    return skeleton, len(added)


def _area_density(skeleton):
    """Points per area of surface that the tree usually has: the median over the nodes."""
    area = 2 * np.pi * skeleton.radius * np.maximum(skeleton.edge_length, 1e-9)
    window = np.maximum(skeleton.fields.get("n_window", np.ones(len(skeleton))), 1)
    return float(np.median(skeleton.fields["n_points"] / (area * window)))


def _expected(trace, density, spacing):
    """Fewest points of a traced way that make wood of it."""
    length = arc_length(trace[0])[-1]
    return LEAST_DENSITY * density * 2 * np.pi * THIN_IN_SPACINGS * spacing * length


def _clusters(points, spacing, sure):
    """Clusters of enough points, largest first: rows and graph of the distances within."""
    pairs = cKDTree(points).query_pairs(spacing, output_type="ndarray")
    step = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    graph = coo_matrix((step + 1e-9, pairs.T), shape=(len(points), len(points))).tocsr()
    graph = graph + graph.T
    n_clusters, member = connected_components(graph, directed=False)
    count = np.bincount(member, minlength=n_clusters)
    n_sure = np.bincount(member, sure, minlength=n_clusters)
    order = np.argsort(member, kind="stable")
    start = np.concatenate([[0], np.cumsum(count)])
    chosen = np.flatnonzero((count >= LEAST_POINTS) & (n_sure >= LEAST_SURE_POINTS))
    chosen = chosen[np.argsort(-count[chosen], kind="stable")]
    found = []
    for cluster in chosen:
        own = order[start[cluster] : start[cluster + 1]]
        found.append((own, graph[own][:, own]))
    return found


def _trace(points, excess, graph, spacing):
    """Way through a cluster from its point nearest to the explained wood to its farthest.

    Returns
    -------
    nodes : ndarray of shape (n, 3)
    first : int
        Row of the point that it starts from.
    """
    first = int(np.argmin(excess))
    way, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    last = int(np.argmax(way))
    length = way[last]
    if length < LEAST_LENGTH * spacing or excess[last] - excess[first] < LEAST_RISE * length:
        return None
    path = [last]
    while before[path[-1]] >= 0:
        path.append(before[path[-1]])
    n_nodes = max(2, int(round(length / spacing)))
    near = cKDTree(points[path]).query(points)[0] <= PATH_WIDTH * spacing
    station = np.minimum((way / length * n_nodes).astype(np.int64), n_nodes - 1)[near]
    count = np.bincount(station, minlength=n_nodes)
    sums = [np.bincount(station, axis, n_nodes) for axis in points[near].T]
    nodes = (np.stack(sums, axis=1) / np.maximum(count, 1)[:, None])[count > 0]
    if len(nodes) < 2:
        return None
    return nodes, first


def _set_on(strands, index, nodes, spacing, noise):
    """Side strand of traced nodes that starts on its parent's axis; None where it cannot."""
    rows = strands.rows(index)
    line, thick, kind = strands.points[rows], strands.radius[rows], strands.label[rows.start]
    at_now, away = nearest_on_polyline(line, nodes[:1])
    radius = float(interpolate(line, thick, at_now)[0])
    at = _meeting_place(line, nodes, float(at_now[0]), radius, spacing)
    start = interpolate(line, line, np.array([at]))[0]
    bare = np.linalg.norm(nodes[0] - start)
    if bare > radius + FARTHEST_START * spacing:
        return None
    is_bridged = away[0] - radius > 2 * spacing + 3 * noise
    n_between = 1 if is_bridged else max(1, int(round(bare / spacing)))
    share = np.linspace(0, 1, n_between + 1)[:-1, None]
    points = np.vstack([start + share * (nodes[0] - start), nodes])
    gap = np.zeros(len(points), dtype=np.int64)
    gap[1 : n_between + 1] = int(is_bridged)
    thin = np.full(len(points), min(THIN_IN_SPACINGS * spacing, radius))
    label = np.full(len(points), 2 if kind in (1, 2) else kind)
    columns = {"points": points, "radius": thin, "label": label, "gap": gap}
    return {**columns, "parent": index, "at": at}


def _meeting_place(line, nodes, at_now, radius, spacing):
    """Arc length on the parent's axis that a way's straight continuation meets."""
    run = nodes[arc_length(nodes) <= DIRECTION_SPAN * spacing]
    window = 4 * radius + 4 * spacing
    place, _ = straight_back(line, run, at_now, window, radius + spacing)
    return float(place) if np.isfinite(place) else at_now
