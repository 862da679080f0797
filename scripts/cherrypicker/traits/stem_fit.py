"""Robust circle and cone fits to the points of a piece of stem.

A slab of stem points is projected along the local axis, a circle is found in it by random
sampling, then a cone (a circle whose centre and radius change linearly along the axis) is fitted
to all points of the slab by iteratively reweighted Gauss-Newton. A joint fit over the slab averages
more noise than single slices, is free of tilt and taper, and lets a minority of foreign points (a
calibration ring, a post, a twig, floaters) get weight zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.geometry.ordering import median
from cherrypicker.traits.cone_steps import (
    MAD_TO_SIGMA,
    iterate_cone,
    normal_sums,
    radial_residuals,
    tilt_damping,
    tukey_weights,
)

__all__ = [
    "ConeFit",
    "arc_coverage",
    "bootstrap_radii",
    "fit_cone",
    "search_circle",
    "steady_levels",
]

N_SECTORS = 36
_MAX_BALANCE = 5.0
_PROMISING = 40  # circles whose sectors are looked at


@dataclass
class ConeFit:
    """A cone fitted to a slab of stem points, in the slab's frame (axis along w, origin inside).

    Attributes
    ----------
    parameters : ndarray of shape (6,)
        Centre u0, v0 and radius at w = 0, then their slopes du/dw, dv/dw, dr/dw.
    sigma : float
        Robust standard deviation of the radial residuals, in the cloud's unit.
    weights : ndarray of shape (n_points,)
        Final Tukey weights in [0, 1]; 0 is an outlier.
    arc_deg : float
        Part of the circumference that inliers cover, degrees, in steps of 10.
    """

    parameters: np.ndarray
    sigma: float
    weights: np.ndarray
    arc_deg: float

    @property
    def radius(self) -> float:
        """Radius at w = 0, in the cloud's unit."""
        return float(self.parameters[2])

    @property
    def n_inliers(self) -> int:
        """Number of points with a weight above zero."""
        return int((self.weights > 0).sum())


def search_circle(
    points: np.ndarray,
    tolerance: float,
    radius_range: tuple[float, float],
    rng: np.random.Generator,
    *,
    n_trials: int = 600,
    max_points: int = 1500,
) -> np.ndarray:
    """Find the circle that explains most of a slice by sampling triples of points.

    Each point counts by the inverse of its sector's point count, so that a densely seen side does
    not decide alone; the score is the truncated squared distance (MSAC).

    Parameters
    ----------
    points : ndarray of shape (n_points, 2), float64
        Slice in the plane across the axis, origin near the axis.
    tolerance : float
        Distance to the circle at which a point no longer supports it, in the cloud's unit.
    radius_range : tuple of float
        Least and largest radius accepted.
    rng : numpy.random.Generator
    n_trials : int, default 600
    max_points : int, default 1500
        Points that score the candidates.

    Returns
    -------
    circle : ndarray of shape (3,)
        Centre u, v and radius.

    Raises
    ------
    StageError
        If no candidate circle lies in the range.
    """
    if len(points) > max_points:
        points = points[rng.choice(len(points), max_points, replace=False)]
    triples = rng.integers(0, len(points), (n_trials, 3))
    circles = _circles_through(points[triples])
    low, high = radius_range
    reach = np.hypot(circles[:, 0], circles[:, 1])
    usable = np.isfinite(circles).all(axis=1) & (circles[:, 2] >= low) & (circles[:, 2] <= high)
    usable &= reach <= high + circles[:, 2]
    circles = circles[usable]
    if not len(circles):
        raise StageError("no circle fits the stem points", key="traits.trunk_height_m")
    return circles[_best_circle(np.ascontiguousarray(points), circles, tolerance)]


@numba.njit(cache=True)
def _best_circle(points: np.ndarray, circles: np.ndarray, tolerance: float) -> int:
    """Row of the circle that most points lie near, by sectors, of those with the least miss."""
    promising, missed, n = np.empty(_PROMISING, dtype=np.int64), np.empty(_PROMISING), 0
    for row in range(len(circles)):
        total = 0.0
        for point in range(len(points)):
            total += _miss(points, point, circles, row, tolerance)
            if n == _PROMISING and total >= missed[n - 1]:
                break
        else:
            at = min(n, _PROMISING - 1)
            while at > 0 and missed[at - 1] > total:
                missed[at], promising[at] = missed[at - 1], promising[at - 1]
                at -= 1
            missed[at], promising[at] = total, row
            n = min(n + 1, _PROMISING)
    best, most, offset = promising[0], -1.0, np.empty((len(points), 2))
    for row in promising[:n]:
        for point in range(len(points)):
            for axis in range(2):
                offset[point, axis] = points[point, axis] - circles[row, axis]
        weights, score = _sector_weights(offset), 0.0
        for point in range(len(points)):
            score += (1.0 - _miss(points, point, circles, row, tolerance)) * weights[point]
        if score > most:
            best, most = row, score
    return best


@numba.njit(cache=True)
def _miss(points: np.ndarray, point: int, circles: np.ndarray, row: int, tolerance: float) -> float:
    """Squared distance of a point from a circle in tolerances, 1 at most."""
    x, y = points[point, 0] - circles[row, 0], points[point, 1] - circles[row, 1]
    away = (np.sqrt(x * x + y * y) - circles[row, 2]) / tolerance
    return min(away * away, 1.0)


def fit_cone(
    local: np.ndarray,
    circle: np.ndarray,
    *,
    prior_weights: np.ndarray | None = None,
    n_iterations: int = 30,
) -> ConeFit:
    """Fit a cone to slab points by Tukey-weighted Gauss-Newton.

    Parameters
    ----------
    local : ndarray of shape (n_points, 3), float64
        Points in the slab's frame (u, v across the axis, w along it), in the cloud's unit.
    circle : ndarray of shape (3,)
        First guess at w = 0.
    prior_weights : ndarray of shape (n_points,), optional
        Weights of the points, sector balance by default.
    n_iterations : int, default 30

    Returns
    -------
    ConeFit

    Raises
    ------
    StageError
        If the points do not determine a cone.
    """
    parameters = np.concatenate([circle, np.zeros(3)])
    if prior_weights is None:
        prior_weights = _sector_weights(local[:, :2] - circle[:2])
    local = np.ascontiguousarray(local)
    parameters, residual, sigma = iterate_cone(local, parameters, prior_weights, n_iterations)
    if not np.isfinite(parameters).all() or parameters[2] <= 0:
        raise StageError("no cone fits the stem points", key="traits.trunk_height_m")
    weights = tukey_weights(residual, sigma)
    offset = local[:, :2] - parameters[:2] - local[:, 2:] * parameters[3:5]
    arc = arc_coverage(offset[weights > 0])
    return ConeFit(parameters, float(sigma), weights, arc)


@numba.njit(cache=True)
def _level_shifts(
    residual: np.ndarray, level: np.ndarray, sector: np.ndarray, n_levels: int, min_points: int
) -> np.ndarray:
    """Median over its sectors of each level's median residuals, NaN where points are too few."""
    shift, own = np.full(n_levels, np.nan), np.empty(len(residual))
    n_sectors, counts = 0, np.zeros(n_levels, dtype=np.int64)
    for row in range(len(residual)):
        n_sectors = max(n_sectors, sector[row] + 1)
        counts[level[row]] += 1
    medians = np.empty(n_sectors)
    for at in range(n_levels):
        if counts[at] < min_points:
            continue
        n_medians = 0
        for part in range(n_sectors):
            n_own = 0
            for row in range(len(residual)):
                if level[row] == at and sector[row] == part:
                    own[n_own] = residual[row]
                    n_own += 1
            if n_own:
                medians[n_medians] = median(own[:n_own])
                n_medians += 1
        shift[at] = median(medians[:n_medians])
    return shift


def steady_levels(
    local: np.ndarray, fit: ConeFit, *, n_levels: int = 16, min_points: int = 6
) -> np.ndarray:
    """Points of the levels whose radius goes with the others'.

    A ring around the stem, or a knot, moves all points of its levels by a distance that a robust
    fit of single points may take for noise. Levels are compared instead: each level's median
    residual against a Theil-Sen line through all of them.

    Parameters
    ----------
    local : ndarray of shape (n_points, 3), float64
    fit : ConeFit
        A first fit to all points.

    Returns
    -------
    ndarray of shape (n_points,), bool
    """
    low, high = local[:, 2].min(), local[:, 2].max()
    level = ((local[:, 2] - low) / max(high - low, 1e-12) * n_levels).astype(int)
    level = np.minimum(level, n_levels - 1)
    offset = local[:, :2] - fit.parameters[:2] - local[:, 2:] * fit.parameters[3:5]
    sector = _sector(offset, 12)
    residual = radial_residuals(local, fit.parameters)
    near = np.abs(residual) < 0.4 * fit.radius
    shift = _level_shifts(residual[near], level[near], sector[near], n_levels, min_points)
    known = np.flatnonzero(np.isfinite(shift))
    if len(known) < 6:
        return np.ones(len(local), dtype=bool)
    first, second = np.triu_indices(len(known), 1)
    slopes = (shift[known[second]] - shift[known[first]]) / (known[second] - known[first])
    deviation = shift - np.median(slopes) * np.arange(n_levels)
    deviation -= np.median(deviation[known])
    spread = MAD_TO_SIGMA * np.median(np.abs(deviation[known]))
    allowed = max(3.0 * spread, 0.02 * fit.radius)
    is_steady = np.isnan(deviation) | (np.abs(deviation) <= allowed)
    return is_steady[level]


def bootstrap_radii(
    local: np.ndarray,
    fit: ConeFit,
    n_samples: int,
    rng: np.random.Generator,
    *,
    n_sectors: int = 12,
    n_levels: int = 4,
) -> np.ndarray:
    """Radii at w = 0 of cones refitted to resampled points.

    Neighbouring points of a photogrammetric cloud share their errors, so whole cells (sector times
    level) are drawn with replacement, not single points.

    Parameters
    ----------
    local : ndarray of shape (n_points, 3), float64
    fit : ConeFit
        The fit to all points; the refits start from it and keep its weights as robust weights.
    n_samples : int
    rng : numpy.random.Generator

    Returns
    -------
    radii : ndarray of shape (n_samples,), float64
        In the cloud's unit; only refits that succeeded.
    """
    use = fit.weights > 0
    points, weights = local[use], fit.weights[use]
    offset = points[:, :2] - fit.parameters[:2] - points[:, 2:] * fit.parameters[3:5]
    sector = _sector(offset, n_sectors)
    low, high = points[:, 2].min(), points[:, 2].max()
    level = ((points[:, 2] - low) / max(high - low, 1e-12) * n_levels).astype(int)
    cell = sector * n_levels + np.minimum(level, n_levels - 1)
    cells, cell = np.unique(cell, return_inverse=True)
    weights = weights * _sector_weights(offset)
    # One Gauss-Newton step from the fit to all points, its sums kept per cell: the refits differ
    # little from that fit, and a sample then costs a 6 x 6 system.
    residual = radial_residuals(points, fit.parameters)
    normals, gradients = normal_sums(points, fit.parameters, residual, weights, cell, len(cells))
    damping = tilt_damping(points, weights)
    drawn = rng.multinomial(len(cells), np.full(len(cells), 1.0 / len(cells)), n_samples)
    normal = np.einsum("sc,cij->sij", drawn, normals) + np.diag(damping)
    gradient = drawn @ gradients + damping * np.concatenate([np.zeros(3), fit.parameters[3:]])
    radii = fit.radius - np.linalg.solve(normal, gradient[:, :, None])[:, 2, 0]
    return radii[np.isfinite(radii) & (radii > 0.3 * fit.radius) & (radii < 3.0 * fit.radius)]


def arc_coverage(offset: np.ndarray, n_sectors: int = N_SECTORS) -> float:
    """Degrees of a circle whose sectors hold a point; `offset` (n, 2) is relative to the centre."""
    return 360.0 * len(np.unique(_sector(offset, n_sectors))) / n_sectors


@numba.njit(cache=True)
def _sector(offset: np.ndarray, n_sectors: int | np.int64) -> np.ndarray:
    sector = np.empty(len(offset), dtype=np.int64)
    for row in range(len(offset)):
        turn = np.arctan2(offset[row, 1], offset[row, 0]) / (2 * np.pi) + 0.5
        sector[row] = min(int(turn * n_sectors), n_sectors - 1)
    return sector


@numba.njit(cache=True)
def _sector_weights(offset: np.ndarray) -> np.ndarray:
    """Weights that even out the number of points per sector, at most by `_MAX_BALANCE`."""
    sector, count = _sector(offset, np.int64(N_SECTORS)), np.zeros(N_SECTORS)
    for part in sector:
        count[part] += 1
    filled, n_filled = np.empty(N_SECTORS), 0
    for part in range(N_SECTORS):
        filled[n_filled] = count[part]
        n_filled += count[part] > 0
    typical, weights = median(filled[:n_filled]) if n_filled else np.nan, np.empty(len(sector))
    for row in range(len(sector)):
        balance = typical / count[sector[row]]
        weights[row] = min(max(balance, 1.0 / _MAX_BALANCE), _MAX_BALANCE)
    return weights


def _circles_through(triples: np.ndarray) -> np.ndarray:
    """Circles through three points each, (n, 3) of u, v, r; not finite where they are in line."""
    a, b, c = triples[:, 0], triples[:, 1], triples[:, 2]
    ab, ac = b - a, c - a
    cross = 2.0 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    ab2, ac2 = (ab**2).sum(axis=1), (ac**2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (ac[:, 1] * ab2 - ab[:, 1] * ac2) / cross
        v = (ab[:, 0] * ac2 - ac[:, 0] * ab2) / cross
    return np.column_stack([a[:, 0] + u, a[:, 1] + v, np.hypot(u, v)])
