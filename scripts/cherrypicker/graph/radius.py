"""Radii of a graph that never grow from the root to a tip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cherrypicker.compiled import compiled
from cherrypicker.geometry.ordering import median
from cherrypicker.skeleton.axes import axis_runs
from cherrypicker.skeleton.model import Skeleton

__all__ = ["taper_skeleton"]


def taper_skeleton(skeleton: Skeleton) -> Skeleton:
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


@compiled
def _running_medians(nodes: np.ndarray, first: np.ndarray, radius: np.ndarray) -> np.ndarray:
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


@compiled
def _never_growing(parent: np.ndarray, radius: np.ndarray, weights: np.ndarray) -> np.ndarray:
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
