"""Radii of a graph's nodes: what the circles say, less the noise of thin wood."""

from dataclasses import replace

import numba
import numpy as np

from cherrypicker.geometry.axis_radii import fit_axis_radii
from cherrypicker.geometry.ordering import median
from cherrypicker.skeleton.axes import axis_runs

__all__ = ["fit_radii", "taper_skeleton"]

CLEAR_ARC, CLEAR_SPREAD, FEWEST_CLEAR = 240.0, 0.25, 10  # circles that tell the noise
CLEAR_QUANTILE = 0.25  # bark, flutes and bends scatter points as well: the calmer circles count
RAYLEIGH_SPREAD = 0.6  # robust spread of the distances from an axis without radius, over the noise
LEAST_SHARE = 0.3  # of the distance of its points that a radius has


def fit_radii(skeleton, surface, *, spacing, max_radius):
    """Radius of each node from the surface points around it, less what noise adds to it.

    Parameters
    ----------
    skeleton, surface, spacing, max_radius
        See `cherrypicker.geometry.axis_radii.fit_axis_radii`.

    Returns
    -------
    Skeleton
        With `radius` and the fields ``n_points``, ``arc_deg``, ``residual``; nodes stay in place.
    """
    return fit_axis_radii(
        skeleton,
        surface,
        spacing=spacing,
        max_radius=max_radius,
        recentre=False,
        less_noise=_less_common_noise,
    )


def _less_common_noise(fits):
    """Radii less what noise adds to them.

    Points at r from an axis, with noise s across it, lie at distances of a Rice distribution, whose
    squared median is r^2 + s^2 where r is large and 1.386 s^2 where it is none. Wood thinner than
    the noise hides it: the distances then scatter by less than s. So s is the scatter around the
    clear circles of thicker wood, but no more than thin wood's own scatter allows for.
    """
    radius, spread, is_circle = fits[:, 0], fits[:, 4], fits[:, 5] > 0
    clear = is_circle & (fits[:, 3] >= CLEAR_ARC) & (spread < CLEAR_SPREAD * radius)
    noise = spread
    if np.count_nonzero(clear) >= FEWEST_CLEAR:
        noise = np.maximum(spread, np.quantile(spread[clear], CLEAR_QUANTILE))
        noise = np.where(is_circle, spread, np.minimum(noise, spread / RAYLEIGH_SPREAD))
    squared, noise = radius**2, np.maximum(noise, 1e-12) ** 2
    found = squared - noise
    for _ in range(3):
        share = 0.386 * np.exp(-np.maximum(found, 0.0) / (2 * noise))
        found = squared - noise * (1 + np.where(is_circle, 0.0, share))
    return np.sqrt(np.maximum(found, LEAST_SHARE**2 * squared))


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
