"""Split the support post from the trunk class.

The post is annotated with the trunk and separated afterwards, as in the paper: it is straight,
near vertical and of constant radius, and it stands beside a stem. A cylinder is fitted to the
trunk's points by random sampling and least squares and accepted only if it passes all of these,
and if a stem is left beside it: a lone straight stem is never taken for a post.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import theilslopes

from cherrypicker.classes import Label, wood_mask
from cherrypicker.geometry.robust import robust_sigma
from cherrypicker.geometry.sections import circles_through, fit_section
from cherrypicker.segmentation.refine import link_components
from cherrypicker.segmentation.spheres import TreeFrame

__all__ = [
    "Cylinder",
    "PostModel",
    "find_post",
    "graded_posts",
    "label_post",
    "split_support_post",
]

logger = logging.getLogger(__name__)

# All but the cost are guesses, held against generated scenes with posts (docs/segmentation.md).
# The cost
MAX_FIT_POINTS = 8000
MAX_REFIT_POINTS = 2000
TEST_POINTS = 1500
N_TRIALS = 3000
MAX_STEMS = 12
# The search
FEWEST_POINTS = 200
STEM_GAP_M = 0.25  # pieces of trunk this near to one another are searched together
SLICE_M = 0.10  # height of the slices that circles, taper and bend are taken from
REACH_IN_WIDEST = 2.2  # points of a circle lie this near together, in radii of the widest post
N_TRIES = 8  # for each partner of a point
ALIKE = 0.25  # radii of two circles of a post differ by this share at most
ON_SURFACE = 0.6  # of the tolerance: points of a candidate
INSIDE_COST = 2  # points inside count so many times against it
APART_M = 0.025  # candidates at middle height, at least
N_CANDIDATES = 5
# The fit
N_ROUNDS = 3
FEWEST_NEAR = 50
LEAST_TOLERANCE_M = 0.003
# The grade
MIN_POINTS = 60  # on the surface of a post
STEP_M = 0.05
SPAN_GAP_M = 0.20  # longest gap in a post
FEWEST_IN_SLICE = 12
SEEN_SLICES = 0.6  # share of the slices with enough points, at least
FOOT_M = 0.3  # a post starts this near to the lowest point
SHARP = 0.5  # share of the points around its surface that lie on it, at least
BEND_SHARE = 0.75  # of the slices whose bend counts
ONE_SIDED = 0.2  # singular values below this share of the first: a slice seen from one side
CLEAR = 1.5  # tolerances off the surface, from where on a point is of something else
BESIDE_M = (0.1, 0.6)  # heights above the foot in which a stem must stand beside,
BESIDE_POINTS = 10  # with so many points
BESIDE_SHARE = 0.6  # in this share of the steps
CROWN_M = (-0.05, 0.15)  # heights about a cylinder's top where a crown would spread
CROWN_REACH_M = 0.10
CROWN_SECTORS = (12, 4)  # sectors around it, and those with wood that make a crown
CROWN_SHARE = 0.03  # points of a sector with wood, as a share of as much height of the cylinder


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

    def offsets(self, points: np.ndarray) -> np.ndarray:
        """Horizontal offset (n, 2) of points from the axis."""
        z = points[:, 2]
        return points[:, :2] - np.stack(
            [self.x + self.slope_x * z, self.y + self.slope_y * z], axis=1
        )

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Horizontal distance (n,) of points from the axis."""
        return np.linalg.norm(self.offsets(points), axis=1)


def _slice_circles(
    points: np.ndarray, rng: np.random.Generator, n_trials: int, model: PostModel
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Circles through three random points that share a thin slice and lie near one another."""
    order = np.argsort(points[:, 2], kind="stable")
    z = points[order, 2]
    first = rng.integers(len(points), size=n_trials)
    low = np.searchsorted(z, z[first] - SLICE_M / 2)
    high = np.searchsorted(z, z[first] + SLICE_M / 2)
    # Several tries a slice: the partners must lie within a post's diameter of the first point.
    reach = REACH_IN_WIDEST * model.radius_range_m[1]
    a = points[order[first]]
    partners = []
    for _ in range(2):
        best = np.full(n_trials, -1)
        for _ in range(N_TRIES):
            pick = low + (rng.random(n_trials) * (high - low)).astype(int)
            near = np.linalg.norm(points[order[pick]][:, :2] - a[:, :2], axis=1) < reach
            best = np.where((best < 0) & near, pick, best)
        partners.append(best)
    found = (partners[0] >= 0) & (partners[1] >= 0)
    a, z0 = a[found], z[first[found]]
    b, c = (points[order[p[found]]] for p in partners)
    circles = circles_through(np.stack([a, b, c], axis=1)[:, :, :2])
    center, radius = circles[:, :2], circles[:, 2]
    fits = (radius >= model.radius_range_m[0]) & (radius <= model.radius_range_m[1])
    return center[fits], radius[fits], z0[fits]


def _candidates(points: np.ndarray, model: PostModel, rng: np.random.Generator) -> list[Cylinder]:
    """Cylinders through pairs of circles of alike radius, one above the other, best first."""
    center, radius, z = _slice_circles(points, rng, N_TRIALS * 4, model)
    if len(z) < 2:
        return []
    i, j = rng.integers(len(z), size=(2, N_TRIALS * 20))
    rise = z[j] - z[i]
    slope = (center[j] - center[i]) / np.where(rise == 0, np.nan, rise)[:, None]
    alike = np.abs(radius[i] - radius[j]) < ALIKE * np.minimum(radius[i], radius[j])
    steep = np.linalg.norm(slope, axis=1) < np.tan(np.deg2rad(model.post_max_tilt_deg))
    good = np.flatnonzero((rise > 0.5 * model.post_min_height_m) & alike & steep)[:N_TRIALS]
    if not len(good):
        return []
    i, j, slope = i[good], j[good], slope[good]
    base = center[i] - slope * z[i][:, None]
    mean_radius = 0.5 * (radius[i] + radius[j])
    test = points[rng.permutation(len(points))[:TEST_POINTS]]
    axis = base[:, None, :] + slope[:, None, :] * test[None, :, 2:3]  # (candidates, points, 2)
    distance = np.linalg.norm(test[None, :, :2] - axis, axis=2)
    on = np.abs(distance - mean_radius[:, None]) < ON_SURFACE * model.tolerance_m
    inside = distance < mean_radius[:, None] - model.tolerance_m
    score = on.sum(axis=1) - INSIDE_COST * inside.sum(axis=1)
    ranked = np.argsort(-score, kind="stable")
    found: list[Cylinder] = []
    taken = np.zeros((0, 2))
    for best in ranked[: N_TRIALS // 4]:
        middle = base[best] + slope[best] * np.median(test[:, 2])
        if len(taken) and np.linalg.norm(taken - middle, axis=1).min() < APART_M:
            continue
        taken = np.vstack([taken, middle])
        found.append(Cylinder(*(float(v) for v in (*base[best], *slope[best], mean_radius[best]))))
        if len(found) == N_CANDIDATES:
            break
    return found


def _tolerance(points: np.ndarray, cylinder: Cylinder, model: PostModel) -> float:
    """Three times the robust scatter of the points about the surface, within bounds."""
    residual = np.abs(cylinder.distance(points) - cylinder.radius)
    residual = residual[residual < model.tolerance_m]
    if not len(residual):
        return model.tolerance_m
    return float(np.clip(3 * robust_sigma(residual), LEAST_TOLERANCE_M, model.tolerance_m))


def _refit(points: np.ndarray, cylinder: Cylinder, model: PostModel) -> Cylinder | None:
    """Least-squares axis and radius from the points near a cylinder's surface, robust loss."""
    reach = model.tolerance_m
    for _ in range(N_ROUNDS):
        near = np.flatnonzero(np.abs(cylinder.distance(points) - cylinder.radius) < reach)
        if len(near) < FEWEST_NEAR:
            return None
        part = points[near[:: 1 + len(near) // MAX_REFIT_POINTS]]

        start = [cylinder.x, cylinder.y, cylinder.radius, cylinder.slope_x, cylinder.slope_y]
        fit = fit_section(part, np.array(start), tapers=False, waves=False)
        if fit is None:
            return None
        x, y, radius, slope_x, slope_y = fit.parameters[:5].tolist()
        cylinder = Cylinder(x, y, slope_x, slope_y, radius)
        reach = _tolerance(points, cylinder, model)
    return cylinder


def _span(heights: np.ndarray) -> tuple[float, float]:
    """Longest run of occupied height steps without a longer gap; (low, high)."""
    occupied = np.unique(np.floor(heights / STEP_M).astype(int))
    runs = np.split(occupied, np.flatnonzero(np.diff(occupied) > SPAN_GAP_M / STEP_M) + 1)
    longest = max(runs, key=lambda run: run[-1] - run[0])
    return longest[0] * STEP_M, (longest[-1] + 1) * STEP_M


def _profile(points: np.ndarray, cylinder: Cylinder) -> np.ndarray:
    """Height, radius, centre offset (x, y) of each slice of a cylinder with enough points."""
    offsets = cylinder.offsets(points)
    distance = np.linalg.norm(offsets, axis=1)
    index = np.floor((points[:, 2] - cylinder.low) / SLICE_M).astype(int)
    rows = []
    for s in np.unique(index):
        here = index == s
        if here.sum() < FEWEST_IN_SLICE:
            continue
        # A slice seen from one side tells the shift along that side only; the truncation of
        # small singular values leaves the other direction at zero.
        direction = offsets[here] / distance[here, None].clip(1e-9)
        shift, *_ = np.linalg.lstsq(direction, distance[here] - cylinder.radius, rcond=ONE_SIDED)
        rows.append((cylinder.low + (s + 0.5) * SLICE_M, np.median(distance[here]), *shift))
    return np.array(rows).reshape(-1, 4)


def _grade(
    points: np.ndarray, cylinder: Cylinder, model: PostModel
) -> tuple[float, Cylinder] | None:
    """How far from a perfect post a cylinder is, and the cylinder with its span; else None."""
    tolerance = _tolerance(points, cylinder, model)
    distance = cylinder.distance(points)
    near = np.abs(distance - cylinder.radius) < tolerance
    tilt = np.rad2deg(np.arctan(np.hypot(cylinder.slope_x, cylinder.slope_y)))
    in_range = model.radius_range_m[0] <= cylinder.radius <= model.radius_range_m[1]
    if near.sum() < MIN_POINTS or tilt > model.post_max_tilt_deg or not in_range:
        return None
    low, high = _span(points[near, 2])
    starts_low = low < np.quantile(points[:, 2], 0.01) + FOOT_M
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
    is_sharp = near.sum() >= SHARP * shell.sum()
    if not is_hollow or not is_sharp or len(profile) < SEEN_SLICES * (high - low) / SLICE_M:
        return None
    taper = abs(theilslopes(profile[:, 1], profile[:, 0])[0]) * (high - low) / cylinder.radius
    bend = float(np.quantile(np.linalg.norm(profile[:, 2:], axis=1), BEND_SHARE))
    if taper > model.max_taper or bend > model.max_bend_m:
        return None
    return taper / model.max_taper + bend / model.max_bend_m, cylinder


def _has_stem_beside(points: np.ndarray, cylinder: Cylinder, model: PostModel) -> bool:
    """Whether points stand clear of the cylinder in most steps above its foot."""
    clear = cylinder.distance(points) > cylinder.radius + CLEAR * model.tolerance_m
    z = points[clear, 2]
    steps = np.arange(cylinder.low + BESIDE_M[0], cylinder.low + BESIDE_M[1], SLICE_M)
    counts = np.array([((z >= s) & (z < s + SLICE_M)).sum() for s in steps])
    return bool((counts >= BESIDE_POINTS).mean() >= BESIDE_SHARE)


def _carries_crown(wood: np.ndarray, cylinder: Cylinder, model: PostModel) -> bool:
    """Whether wood spreads out from the top of a cylinder, as from the fork of a short stem.

    A post that stands in a crown has wood of the crown on one side of its top or two; a stem that
    forks there has its arms all around.
    """
    offsets, z = cylinder.offsets(wood), wood[:, 2]
    distance = np.linalg.norm(offsets, axis=1)
    own = (np.abs(distance - cylinder.radius) < model.tolerance_m) & (z > cylinder.low)
    own &= z < cylinder.high
    aside = distance > cylinder.radius + CLEAR * model.tolerance_m
    aside &= distance < cylinder.radius + CROWN_REACH_M
    aside &= (z > cylinder.high + CROWN_M[0]) & (z < cylinder.high + CROWN_M[1])
    n_sectors, fewest = CROWN_SECTORS
    turn = np.arctan2(offsets[aside, 1], offsets[aside, 0]) / (2 * np.pi) + 0.5
    count = np.bincount((turn * n_sectors).astype(int) % n_sectors, minlength=n_sectors)
    wanted = CROWN_SHARE * CROWN_M[1] * own.sum() / (cylinder.high - cylinder.low)
    return bool((count >= max(wanted, 3)).sum() >= fewest)


def label_post(local: np.ndarray, labels: np.ndarray, post: Cylinder, model: PostModel) -> int:
    """Label the wood on a post's surface, in place, and return how many points it has.

    Branches count within half the reach of trunk.
    """
    wood = np.flatnonzero(wood_mask(labels))
    z = local[wood, 2]
    reach = np.where(labels[wood] == Label.TRUNK, model.tolerance_m, 0.5 * model.tolerance_m)
    spanned = (z >= post.low - STEP_M) & (z <= post.high + STEP_M)
    chosen = wood[(post.distance(local[wood]) < post.radius + reach) & spanned]
    labels[chosen] = Label.SUPPORT_POST
    return len(chosen)


def graded_posts(
    points: np.ndarray,
    model: PostModel,
    seed: int = 0,
    wood: np.ndarray | None = None,
    beside: np.ndarray | None = None,
) -> list[tuple[float, Cylinder]]:
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
    if len(points) < FEWEST_POINTS or np.ptp(points[:, 2]) < model.post_min_height_m:
        return []
    rng = np.random.default_rng(seed)
    points = points[np.sort(rng.permutation(len(points))[:MAX_FIT_POINTS])]
    graded = []
    for candidate in _candidates(points, model, rng):
        refined = _refit(points, candidate, model)
        found = None if refined is None else _grade(points, refined, model)
        if found is None or not _has_stem_beside(
            points if beside is None else beside, found[1], model
        ):
            continue
        if wood is None or not _carries_crown(wood, found[1], model):
            graded.append(found)
    return sorted(graded, key=lambda entry: entry[0])


def find_post(
    points: np.ndarray, model: PostModel, seed: int = 0, wood: np.ndarray | None = None
) -> Cylinder | None:
    """Support post among the trunk's points of one stem: the best of `graded_posts`, or None."""
    graded = graded_posts(points, model, seed, wood)
    return graded[0][1] if graded else None


def split_support_post(
    points: np.ndarray, labels: np.ndarray, frame: TreeFrame, model: PostModel
) -> np.ndarray:
    """Give the points of support posts their own label.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        In the cloud's frame.
    labels : ndarray of shape (n,), uint8
    frame : cherrypicker.segmentation.spheres.TreeFrame
        Only its origin enters; a shrunk cloud keeps the size of its post.
    model : PostModel

    Returns
    -------
    ndarray of shape (n,), uint8
        A copy with label 7 on the posts. Branch points on a post's surface are taken along.
    """
    labels = labels.copy()
    local = points - frame.origin
    trunk = np.flatnonzero(labels == Label.TRUNK)
    around = local[wood_mask(labels)]
    group = link_components(local[trunk], STEM_GAP_M)
    for g in range(min(group.max() + 1 if len(group) else 0, MAX_STEMS)):
        stem = trunk[group == g]
        post = find_post(local[stem], model, wood=around)
        if post is not None:
            n = label_post(local, labels, post, model)
            logger.info(
                "support post of %.0f mm diameter from %.2f to %.2f m: %s of %s points of its stem",
                2000 * post.radius, post.low, post.high, f"{n:,}", f"{len(stem):,}",
            )  # fmt: skip
    return labels
