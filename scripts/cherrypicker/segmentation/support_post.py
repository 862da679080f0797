"""Split the support post from the trunk class.

The post is annotated with the trunk and separated afterwards, as in the paper: it is straight,
near vertical and of constant radius, and it stands beside a stem. A cylinder is fitted to the
trunk's points by random sampling and least squares and accepted only if it passes all of these,
and if a stem is left beside it: a lone straight stem is never taken for a post.
"""

import logging
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import theilslopes

from cherrypicker.classes import Label, wood_mask
from cherrypicker.geometry.sections import circles_through, fit_section
from cherrypicker.segmentation.refine import link_components

logger = logging.getLogger(__name__)

_MAX_FIT_POINTS = 8000
_MAX_REFIT_POINTS = 2000
_N_TRIALS = 3000
_MAX_STEMS = 12


@dataclass(frozen=True)
class PostModel:
    """What counts as a support post; lengths in metres of the tree's frame.

    ``post_min_height_m`` and ``post_max_tilt_deg`` are config keys of ``segment``.

    Attributes
    ----------
    radius_range_m : tuple of float
    max_taper : float
        Change of the radius over the cylinder's length, as a share of the radius.
    max_bend_m : float
        Deviation of three quarters of the centre line from a straight line.
    max_inside : float
        Points inside the cylinder at most, as a share of those on its surface.
    tolerance_m : float
        Distance from the surface up to which a point may belong to it; the scatter of the
        surface's own points lowers it.
    """

    post_min_height_m: float = 0.6
    radius_range_m: tuple[float, float] = (0.008, 0.07)
    post_max_tilt_deg: float = 8.0
    max_taper: float = 0.2
    max_bend_m: float = 0.005
    max_inside: float = 0.25
    tolerance_m: float = 0.010


@dataclass(frozen=True)
class Cylinder:
    """Axis through ``(x, y)`` at z = 0 with slope ``dx/dz, dy/dz``; radius; heights it spans."""

    x: float
    y: float
    slope_x: float
    slope_y: float
    radius: float
    low: float = 0.0
    high: float = 0.0

    def offsets(self, points):
        """Horizontal offset (n, 2) of points from the axis."""
        z = points[:, 2]
        return points[:, :2] - np.stack(
            [self.x + self.slope_x * z, self.y + self.slope_y * z], axis=1
        )

    def distance(self, points):
        """Horizontal distance (n,) of points from the axis."""
        return np.linalg.norm(self.offsets(points), axis=1)


def _slice_circles(points, rng, n_trials, model, height=0.10):
    """Circles through three random points that share a thin slice and lie near one another."""
    order = np.argsort(points[:, 2], kind="stable")
    z = points[order, 2]
    first = rng.integers(len(points), size=n_trials)
    low = np.searchsorted(z, z[first] - height / 2)
    high = np.searchsorted(z, z[first] + height / 2)
    # Several tries a slice: the partners must lie within a post's diameter of the first point.
    reach = 2.2 * model.radius_range_m[1]
    a = points[order[first]]
    partners = []
    for _ in range(2):
        best = np.full(n_trials, -1)
        for _ in range(8):
            pick = low + (rng.random(n_trials) * (high - low)).astype(int)
            near = np.linalg.norm(points[order[pick]][:, :2] - a[:, :2], axis=1) < reach
            best = np.where((best < 0) & near, pick, best)
        partners.append(best)
    found = (partners[0] >= 0) & (partners[1] >= 0)
    a, z0 = a[found], z[first[found]]
    b, c = (points[order[p[found]]] for p in partners)
    *center, radius = circles_through(np.stack([a, b, c], axis=1)[:, :, :2]).T
    center = np.stack(center, axis=1)
    fits = (radius >= model.radius_range_m[0]) & (radius <= model.radius_range_m[1])
    return center[fits], radius[fits], z0[fits]


def _candidates(points, model, rng):
    """Cylinders through pairs of circles of alike radius, one above the other, best first."""
    center, radius, z = _slice_circles(points, rng, _N_TRIALS * 4, model)
    if len(z) < 2:
        return []
    i, j = rng.integers(len(z), size=(2, _N_TRIALS * 20))
    rise = z[j] - z[i]
    slope = (center[j] - center[i]) / np.where(rise == 0, np.nan, rise)[:, None]
    alike = np.abs(radius[i] - radius[j]) < 0.25 * np.minimum(radius[i], radius[j])
    steep = np.linalg.norm(slope, axis=1) < np.tan(np.deg2rad(model.post_max_tilt_deg))
    good = np.flatnonzero((rise > 0.5 * model.post_min_height_m) & alike & steep)[:_N_TRIALS]
    if not len(good):
        return []
    i, j, slope = i[good], j[good], slope[good]
    base = center[i] - slope * z[i][:, None]
    mean_radius = 0.5 * (radius[i] + radius[j])
    test = points[rng.permutation(len(points))[:1500]]
    axis = base[:, None, :] + slope[:, None, :] * test[None, :, 2:3]  # (candidates, points, 2)
    distance = np.linalg.norm(test[None, :, :2] - axis, axis=2)
    on = np.abs(distance - mean_radius[:, None]) < 0.6 * model.tolerance_m
    inside = distance < mean_radius[:, None] - model.tolerance_m
    score = on.sum(axis=1) - 2 * inside.sum(axis=1)
    ranked = np.argsort(-score, kind="stable")
    found, taken = [], np.zeros((0, 2))
    for best in ranked[: _N_TRIALS // 4]:
        middle = base[best] + slope[best] * np.median(test[:, 2])
        if len(taken) and np.linalg.norm(taken - middle, axis=1).min() < 0.025:
            continue
        taken = np.vstack([taken, middle])
        found.append(Cylinder(*base[best], *slope[best], float(mean_radius[best])))
        if len(found) == 5:
            break
    return found


def _tolerance(points, cylinder, model):
    """Three times the robust scatter of the points about the surface, within bounds."""
    residual = np.abs(cylinder.distance(points) - cylinder.radius)
    residual = residual[residual < model.tolerance_m]
    if not len(residual):
        return model.tolerance_m
    return float(np.clip(3 * 1.4826 * np.median(residual), 0.003, model.tolerance_m))


def _refit(points, cylinder, model):
    """Least-squares axis and radius from the points near a cylinder's surface, robust loss."""
    reach = model.tolerance_m
    for _ in range(3):
        near = np.flatnonzero(np.abs(cylinder.distance(points) - cylinder.radius) < reach)
        if len(near) < 50:
            return None
        part = points[near[:: 1 + len(near) // _MAX_REFIT_POINTS]]

        start = [cylinder.x, cylinder.y, cylinder.radius, cylinder.slope_x, cylinder.slope_y]
        fit = fit_section(part, np.array(start), tapers=False, waves=False)
        if fit is None:
            return None
        x, y, radius, slope_x, slope_y = fit.parameters[:5].tolist()
        cylinder = Cylinder(x, y, slope_x, slope_y, radius)
        reach = _tolerance(points, cylinder, model)
    return cylinder


def _span(heights, step=0.05, max_gap=0.20):
    """Longest run of occupied height steps without a gap above `max_gap`; (low, high)."""
    occupied = np.unique(np.floor(heights / step).astype(int))
    breaks = np.flatnonzero(np.diff(occupied) > max_gap / step)
    runs = np.split(occupied, breaks + 1)
    longest = max(runs, key=lambda run: run[-1] - run[0])
    return longest[0] * step, (longest[-1] + 1) * step


def _profile(points, cylinder, step=0.10):
    """Height, radius, centre offset (x, y) of each slice of a cylinder with enough points."""
    offsets = cylinder.offsets(points)
    distance = np.linalg.norm(offsets, axis=1)
    index = np.floor((points[:, 2] - cylinder.low) / step).astype(int)
    rows = []
    for s in np.unique(index):
        here = index == s
        if here.sum() < 12:
            continue
        # A slice seen from one side tells the shift along that side only; the truncation of
        # small singular values leaves the other direction at zero.
        direction = offsets[here] / distance[here, None].clip(1e-9)
        shift, *_ = np.linalg.lstsq(direction, distance[here] - cylinder.radius, rcond=0.2)
        rows.append((cylinder.low + (s + 0.5) * step, np.median(distance[here]), *shift))
    return np.array(rows).reshape(-1, 4)


def _grade(points, cylinder, model):
    """How far from a perfect post a cylinder is, and the cylinder with its span; else None."""
    tolerance = _tolerance(points, cylinder, model)
    distance = cylinder.distance(points)
    near = np.abs(distance - cylinder.radius) < tolerance
    tilt = np.rad2deg(np.arctan(np.hypot(cylinder.slope_x, cylinder.slope_y)))
    in_range = model.radius_range_m[0] <= cylinder.radius <= model.radius_range_m[1]
    if near.sum() < 60 or tilt > model.post_max_tilt_deg or not in_range:
        return None
    low, high = _span(points[near, 2])
    starts_low = low < np.quantile(points[:, 2], 0.01) + 0.3
    if high - low < model.post_min_height_m or not starts_low:
        return None
    cylinder = replace(cylinder, low=float(low), high=float(high))
    spanned = (points[:, 2] >= low) & (points[:, 2] <= high)
    inside = spanned & (distance < cylinder.radius - tolerance)
    near &= spanned
    # A wider shell than the surface's own, else the taper of a stem would be cut off unseen.
    shell = spanned & (np.abs(distance - cylinder.radius) < 2 * model.tolerance_m)
    profile = _profile(points[shell], cylinder)
    is_hollow = inside.sum() <= model.max_inside * near.sum()
    is_sharp = near.sum() >= 0.5 * shell.sum()
    if not is_hollow or not is_sharp or len(profile) < 6 * (high - low):
        return None
    taper = abs(theilslopes(profile[:, 1], profile[:, 0])[0]) * (high - low) / cylinder.radius
    bend = float(np.quantile(np.linalg.norm(profile[:, 2:], axis=1), 0.75))
    if taper > model.max_taper or bend > model.max_bend_m:
        return None
    return taper / model.max_taper + bend / model.max_bend_m, cylinder


def _has_stem_beside(points, cylinder, model, height=0.6):
    """Whether trunk points stand clear of the cylinder in most steps above its foot."""
    clear = cylinder.distance(points) > cylinder.radius + 1.5 * model.tolerance_m
    z = points[clear, 2]
    steps = np.arange(cylinder.low + 0.1, cylinder.low + height, 0.10)
    counts = np.array([((z >= s) & (z < s + 0.10)).sum() for s in steps])
    return bool((counts >= 10).mean() >= 0.6)


def _carries_crown(wood, cylinder, model, reach=0.15):
    """Whether wood spreads out from the top of a cylinder, as from the fork of a short stem.

    A post that stands in a crown has wood of the crown on one side of its top or two; a stem that
    forks there has its arms all around.
    """
    offsets, z = cylinder.offsets(wood), wood[:, 2]
    distance = np.linalg.norm(offsets, axis=1)
    own = (np.abs(distance - cylinder.radius) < model.tolerance_m) & (z > cylinder.low)
    own &= z < cylinder.high
    aside = distance > cylinder.radius + 1.5 * model.tolerance_m
    aside &= distance < cylinder.radius + 0.10
    aside &= (z > cylinder.high - 0.05) & (z < cylinder.high + reach)
    sector = np.floor((np.arctan2(offsets[aside, 1], offsets[aside, 0]) / np.pi + 1) * 6) % 12
    wanted = 0.03 * reach * own.sum() / (cylinder.high - cylinder.low)
    return bool((np.bincount(sector.astype(int), minlength=12) >= max(wanted, 3)).sum() >= 4)


def graded_posts(points, model, seed=0, wood=None, beside=None):
    """Cylinders among wood that count as a support post, the straightest and most constant first.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
        In metres, z up.
    model : PostModel
    seed : int
    wood : ndarray of shape (m, 3), optional
        All wood around; a cylinder that carries a crown is a stem.
    beside : ndarray of shape (k, 3), optional
        Where a stem must stand beside the post; among `points` by default.

    Returns
    -------
    list of (float, Cylinder)
        How far from a perfect post, and the post.
    """
    if len(points) < 200 or np.ptp(points[:, 2]) < model.post_min_height_m:
        return []
    rng = np.random.default_rng(seed)
    fit_points = points[np.sort(rng.permutation(len(points))[:_MAX_FIT_POINTS])]
    graded = []
    for candidate in _candidates(fit_points, model, rng):
        refined = _refit(fit_points, candidate, model)
        result = None if refined is None else _grade(fit_points, refined, model)
        stems = fit_points if beside is None else beside
        if result is None or not _has_stem_beside(stems, result[1], model):
            continue
        if wood is None or not _carries_crown(wood, result[1], model):
            graded.append(result)
    return sorted(graded, key=lambda entry: entry[0])


def find_post(points, model, seed=0, wood=None):
    """Support post among the trunk's points of one stem.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
        Trunk-labelled points in metres, z up.
    model : PostModel
    seed : int
    wood : ndarray of shape (m, 3), optional
        All wood around; a cylinder that carries a crown is a stem.

    Returns
    -------
    Cylinder or None
        Of several cylinders with a stem beside them the straightest and most constant.
    """
    graded = graded_posts(points, model, seed, wood)
    return graded[0][1] if graded else None


def label_post(local, labels, post, model):
    """Label the wood on a post's surface, in place, branches within half the reach of trunk.

    Parameters
    ----------
    local : ndarray of shape (n, 3)
        In the post's frame.
    labels : ndarray of shape (n,), uint8
    post : Cylinder
    model : PostModel

    Returns
    -------
    int
        Number of points of the post.
    """
    wood = np.flatnonzero(wood_mask(labels))
    z = local[wood, 2]
    distance = post.distance(local[wood])
    own = labels[wood] == Label.TRUNK
    reach = post.radius + np.where(own, model.tolerance_m, 0.5 * model.tolerance_m)
    chosen = wood[(distance < reach) & (z >= post.low - 0.05) & (z <= post.high + 0.05)]
    labels[chosen] = Label.SUPPORT_POST
    return len(chosen)


def split_support_post(points, labels, frame, model, seed=0):
    """Give the points of support posts their own label.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        In the cloud's frame.
    labels : ndarray of shape (n,), uint8
    frame : cherrypicker.segmentation.spheres.TreeFrame
        Only its origin enters; a shrunk cloud keeps the size of its post.
    model : PostModel
    seed : int

    Returns
    -------
    ndarray of shape (n,), uint8
        A copy with label 7 on the posts. Branch points on a post's surface are taken along.
    """
    labels = labels.copy()
    local = points - frame.origin
    trunk = np.flatnonzero(labels == Label.TRUNK)
    around = local[wood_mask(labels)]
    group = link_components(local[trunk], 0.25)
    for g in range(min(group.max() + 1 if len(group) else 0, _MAX_STEMS)):
        stem = trunk[group == g]
        post = find_post(local[stem], model, seed, around)
        if post is None:
            continue
        n = label_post(local, labels, post, model)
        logger.info(
            "support post of %.0f mm diameter from %.2f to %.2f m: %s of %s points of its stem",
            2000 * post.radius,
            post.low,
            post.high,
            f"{n:,}",
            f"{len(stem):,}",
        )
    return labels
