"""Repair of what the contraction does to a skeleton: bent junctions, short tips, jitter."""

import logging
from dataclasses import replace

import numba
import numpy as np

from cherrypicker.skeleton.axes import axis_runs
from cherrypicker.skeleton.edge_search import nearest_edges
from cherrypicker.skeleton.refine_axes import refine_strands
from cherrypicker.skeleton.strands import join_strands, split_strands

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
    nodes, first, _, _, attach = axis_runs(skeleton)
    return replace(skeleton, radius=_taper_axes(nodes, first, attach, skeleton.radius, trust))


@numba.njit(cache=True)
def _taper_axes(nodes, first, attach, radius, weights):
    """Tapered radii of all axes, each at most its parent's where it starts."""
    radius = radius.copy()
    for index in range(len(attach)):
        own = nodes[first[index] : first[index + 1]]
        most = radius[attach[index]] if attach[index] >= 0 else np.inf
        tapered = _taper(radius[own], weights[own])
        for row in range(len(own)):
            radius[own[row]] = min(tapered[row], most)
    return radius


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
    owner = np.empty(len(skeleton), dtype=np.int64)
    owner[nodes] = np.repeat(np.arange(len(first) - 1), np.diff(first))
    axis = owner[nearest_edges(skeleton, surface, outside=True)[0]]
    order = np.argsort(axis, kind="stable")
    return order, np.searchsorted(axis[order], np.arange(len(first)))
