"""What the surface points around the nodes of a skeleton tell of their radii."""

from dataclasses import replace

import numpy as np

from cherrypicker.compiled import compiled
from cherrypicker.geometry.robust import MAD_TO_SIGMA
from cherrypicker.geometry.sections import N_SECTORS, arc_deg, judge, median
from cherrypicker.geometry.tree_walks import window
from cherrypicker.skeleton.model import Skeleton, closed_radii, densify

MOST_POINTS = 300  # of a node, evenly drawn from more: bounds the time (guess)
FEWEST_POINTS = 5  # of which a circle is judged: two more than it has numbers
REACH = 1.5  # along the axis, each way, of a node's points: in radii, and in edges at least (guess)
# An edge: the nearest one is found among these. The radii of two skeletons are as by the edges
# themselves (2026-11-26)
SAMPLES = 4
LEAST_RADIUS_M = 0.001  # of a tree of which no point tells any; a guess


def measure_radii(
    skeleton: Skeleton, surface: np.ndarray, *, spacing: float, max_radius: float
) -> Skeleton:
    """Say of each node what the points around it tell of its radius.

    These are the points nearest to the node and to its neighbours along the axis, as seen across
    the axis. Of a node without a radius it is their median distance from the axis, with too few
    points the radius below it, at the root the first that is known.

    Radii that are 0 are measured, the others kept. Points of the surface, (n_points, 3), are wood
    of the original cloud in the skeleton's frame; those farther than `max_radius` from it are left
    out. Nodes lie a spacing apart.

    The skeleton comes back with ``n_points``, ``arc_deg``, ``residual`` and ``radius_error``, as
    `Skeleton` tells, of the circle of each node's radius; zero where there are too few points.
    """
    samples = densify(skeleton, spacing / SAMPLES)
    distance, nearest = samples.nearest(surface, max_radius)
    near = np.isfinite(distance)
    surface, edge = surface[near], samples.node[nearest[near]]
    ends = np.stack([edge, np.maximum(skeleton.parent[edge], 0)])
    away = np.linalg.norm(surface - skeleton.points[ends], axis=2)
    owner = np.where(away[0] <= away[1], *ends)
    order = np.argsort(owner, kind="stable")
    start = np.searchsorted(owner[order], np.arange(len(skeleton) + 1))
    reach = REACH * np.maximum(skeleton.radius, spacing)
    only_child = np.full(len(skeleton), -1)
    only_child[skeleton.parent[1:]] = np.arange(1, len(skeleton))
    only_child[skeleton.n_children > 1] = -1
    tree = skeleton.parent, skeleton.edge_length, only_child
    n_points, told = _measured(surface[order], start, tree, reach, skeleton.points, skeleton.radius)
    radius, arc, residual, error = told.T
    radius = np.where(radius > 0, radius, np.nan)
    radius = closed_radii(radius, skeleton.parent, LEAST_RADIUS_M)
    fields = {"n_points": n_points, "arc_deg": arc, "residual": residual, "radius_error": error}
    return replace(skeleton, radius=radius, fields=skeleton.fields | fields)


def typical_scatter(skeleton: Skeleton) -> float | None:
    """Median scatter around the radii, ``residual``, 0 where no radius was fitted; None if none."""
    scatter = skeleton.fields.get("residual", np.zeros(0))
    scatter = scatter[scatter > 0]
    return float(np.median(scatter)) if len(scatter) else None


@compiled
def _measured(
    surface: np.ndarray,
    start: np.ndarray,
    tree: tuple,
    reach: np.ndarray,
    nodes: np.ndarray,
    radius: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Number of points around each node; its radius, covered arc, scatter and standard error.

    `surface` is sorted by the node that each point belongs to, whose first rows are `start`;
    `tree` is as for `window`.
    """
    n_nodes, parent = len(nodes), tree[0]
    told, counts = np.zeros((n_nodes, 4)), np.zeros(n_nodes, dtype=np.int64)
    near = np.empty(n_nodes, dtype=np.int64)
    most = MOST_POINTS + n_nodes  # the stride begins anew at each node
    local, away = np.ones((most, 4)), np.zeros(most)  # of one height and weight
    u, v = np.empty(3), np.empty(3)
    circle, no_prior = np.zeros(3), np.full(3, np.inf)
    for node in range(n_nodes):
        told[node, 0] = radius[node]
        own = near[: window(node, tree, reach[node], near)]
        counts[node] = (start[own + 1] - start[own]).sum()
        if counts[node] < FEWEST_POINTS:
            continue
        low, high = own.min(), own.max()
        _across(nodes, low if low < high else max(parent[node], 0), high, u, v)
        stride = 1 + counts[node] // MOST_POINTS
        n = 0
        for one in own:
            for row in range(start[one], start[one + 1], stride):
                local[n, 0] = local[n, 1] = 0.0
                for axis in range(3):
                    offset = surface[row, axis] - nodes[node, axis]
                    local[n, 0] += offset * u[axis]
                    local[n, 1] += offset * v[axis]
                away[n] = np.sqrt(local[n, 0] ** 2 + local[n, 1] ** 2)
                n += 1
        if radius[node] == 0.0:
            told[node, 0] = median(away[:n])
        circle[2] = told[node, 0]
        told[node, 2] = MAD_TO_SIGMA * median(np.abs(away[:n] - circle[2]))
        _, offsets, covariance = judge(local[:n], circle, no_prior, told[node, 2])
        told[node, 1] = arc_deg(offsets, N_SECTORS)
        told[node, 3] = np.sqrt(max(covariance[2, 2], 0.0))
    return counts, told


@compiled
def _across(nodes: np.ndarray, low: int, high: int, u: np.ndarray, v: np.ndarray) -> None:
    """Two directions across the way from one node to another, written to `u` and `v`."""
    way = nodes[high] - nodes[low]
    norm = np.sqrt(np.square(way).sum())
    way = way / norm if norm > 0 else np.array([0.0, 0.0, 1.0])
    k = np.abs(way).argmin()  # its cross product with the axis it is farthest from
    u[k], u[(k + 1) % 3], u[(k + 2) % 3] = 0.0, way[(k + 2) % 3], -way[(k + 1) % 3]
    u /= np.sqrt(np.square(u).sum())
    v[:] = np.cross(way, u)
