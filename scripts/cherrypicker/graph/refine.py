"""Repair of what the contraction does to a skeleton: bent junctions, short tips, jitter."""

import logging
from dataclasses import replace

import numba
import numpy as np

from cherrypicker.geometry.edge_search import nearest_edges
from cherrypicker.geometry.ordering import median
from cherrypicker.graph.polyline_tree import join_strands, split_strands
from cherrypicker.graph.smooth_axes import refine_strands
from cherrypicker.skeleton.axes import axis_runs, run_of_node

__all__ = ["refine_skeleton", "taper_radii", "taper_skeleton"]

logger = logging.getLogger(__name__)


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
    radius, n = np.asarray(radius, dtype=np.float64), len(radius)
    smooth = _running_medians(np.arange(n), np.array([0, n]), radius)
    return _never_growing(np.arange(-1, n - 1), smooth, np.asarray(weights, dtype=np.float64))


@numba.njit(cache=True)
def _running_medians(nodes, first, radius):
    """Running medians of five along each run of nodes, ends repeated."""
    smooth = radius.copy()
    for run in range(len(first) - 1):
        own = nodes[first[run] : first[run + 1]]
        half = min(5, len(own) - (len(own) + 1) % 2) // 2
        around = np.empty(2 * half + 1)
        for row in range(len(own)):
            for step in range(-half, half + 1):
                around[step + half] = radius[own[min(max(row + step, 0), len(own) - 1)]]
            smooth[own[row]] = median(around)
    return smooth


@numba.njit(cache=True)
def _never_growing(parent, radius, weights):
    """Weighted least-squares radii that are nowhere larger than their parent's.

    From the tips to the root every node pools with the child block of the largest mean for as
    long as that mean is above its own (isotonic regression on a tree, Pardalos and Xue 1999).
    """
    n = len(radius)
    total, mass, block = weights.copy(), weights.copy(), np.empty(n, dtype=np.int64)
    for node in range(n):
        total[node] *= radius[node]
        block[node] = node
    first, last = np.full(n, -1, dtype=np.int64), np.full(n, -1, dtype=np.int64)
    after = np.full(n, -1, dtype=np.int64)  # the next child block of the same parent's
    for node in range(n - 1, -1, -1):  # parents come before children
        while first[node] >= 0:
            best, before_best, before, at = -1, -1, -1, first[node]
            while at >= 0:
                if best < 0 or total[at] * mass[best] > total[best] * mass[at]:
                    best, before_best = at, before
                before, at = at, after[at]
            if total[best] * mass[node] <= total[node] * mass[best]:
                break
            if before_best < 0:
                first[node] = after[best]
            else:
                after[before_best] = after[best]
            if last[node] == best:
                last[node] = before_best
            if first[best] >= 0:
                if first[node] < 0:
                    first[node] = first[best]
                else:
                    after[last[node]] = first[best]
                last[node] = last[best]
            total[node] += total[best]
            mass[node] += mass[best]
            block[best] = node
        up = parent[node]
        if up >= 0:
            if first[up] < 0:
                first[up] = node
            else:
                after[last[up]] = node
            last[up] = node
    found = np.empty(n)
    for node in range(n):
        block[node] = block[block[node]]
        found[node] = total[block[node]] / mass[block[node]]
    return found


def taper_skeleton(skeleton):
    """Radii that never grow from the root to a tip, near the measured ones.

    Nodes that the radius fit trusts more (more of the circumference, more points) weigh more. All
    axes are fitted at once: where a thick limb leaves a fork whose own nodes have few points, the
    limb's radii say how thick the fork is.

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
    nodes, first, *_ = axis_runs(skeleton)
    smooth = _running_medians(nodes, first, skeleton.radius)
    return replace(skeleton, radius=_never_growing(skeleton.parent, smooth, trust))


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
    surface = np.ascontiguousarray(surface, dtype=np.float64)
    own = _points_by_axis(skeleton, surface)
    strands = refine_strands(strands, surface, *own, spacing, noise)
    return join_strands(strands, spacing, unit=skeleton.unit, frame=skeleton.frame)


def _points_by_axis(skeleton, surface):
    """Rows of the surface points that lie nearest to each axis's wood, axis by axis, and starts."""
    nodes, first, *_ = axis_runs(skeleton)
    owner = run_of_node(nodes, first)
    axis = owner[nearest_edges(skeleton, surface, outside=True)[0]]
    order = np.argsort(axis, kind="stable")
    return order, np.searchsorted(axis[order], np.arange(len(first)))
