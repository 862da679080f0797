"""Robust circle and cone fits to the points of a piece of stem.

A slab of stem points is projected along the local axis, a circle is found in it by random
sampling, then a cone (a circle whose centre and radius change linearly along the axis) is fitted
to all points of the slab by iteratively reweighted Gauss-Newton. A joint fit over the slab averages
more noise than single slices, is free of tilt and taper, and lets a minority of foreign points (a
calibration ring, a post, a twig, floaters) get weight zero.
"""

from dataclasses import dataclass

import numba
import numpy as np

from cherrypicker.errors import StageError

__all__ = [
    "ConeFit",
    "arc_coverage",
    "bootstrap_radii",
    "fit_cone",
    "search_circle",
    "steady_levels",
]

N_SECTORS = 36
_TUKEY = 4.685  # 95 % efficiency on Gaussian residuals
_MAD_TO_SIGMA = 1.4826
_MAX_BALANCE = 5.0


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


def search_circle(points, tolerance, radius_range, rng, *, n_trials=600, max_points=1500):
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
    offset = np.hypot(
        points[:, 0, None] - circles[:, 0], points[:, 1, None] - circles[:, 1]
    )  # (n_points, n_circles)
    miss = np.minimum(((offset - circles[:, 2]) / tolerance) ** 2, 1.0)
    score = np.array(
        [
            ((1.0 - miss[:, i]) * _sector_weights(points - circles[i, :2])).sum()
            for i in _promising(miss)
        ]
    )
    return circles[_promising(miss)[int(np.argmax(score))]]


def fit_cone(local, circle, *, prior_weights=None, n_iterations=30):
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
    residual = _residuals(local, parameters)
    sigma = max(0.15 * circle[2], 1e-9)
    for _ in range(n_iterations):
        weights = _tukey(residual, sigma)
        parameters, step = _gauss_newton(local, parameters, residual, weights * prior_weights)
        residual = _residuals(local, parameters)
        near = np.abs(residual) < 3.0 * sigma
        if near.sum() < 6:
            break
        spread = _MAD_TO_SIGMA * np.median(np.abs(residual[near]))
        # Shrinks towards the spread of the inliers by at most a third a step: a fast drop would
        # lock the fit onto the first guess.
        sigma = max(spread, 0.67 * sigma, 1e-4 * circle[2])
        if step < 1e-6 * circle[2] and sigma <= 1.01 * max(spread, 1e-4 * circle[2]):
            break
    if not np.isfinite(parameters).all() or parameters[2] <= 0:
        raise StageError("no cone fits the stem points", key="traits.trunk_height_m")
    weights = _tukey(residual, sigma)
    offset = local[:, :2] - parameters[:2] - local[:, 2:] * parameters[3:5]
    arc = arc_coverage(offset[weights > 0])
    return ConeFit(parameters, float(sigma), weights, arc)


@numba.njit(cache=True)
def _level_shifts(residual, level, sector, n_levels, min_points):
    """Median over its sectors of each level's median residuals, NaN where points are too few."""
    shift, own = np.full(n_levels, np.nan), np.empty(len(residual))
    n_sectors = sector.max() + 1 if len(sector) else 0
    medians = np.empty(n_sectors)
    for at in range(n_levels):
        if (level == at).sum() < min_points:
            continue
        n_medians = 0
        for part in range(n_sectors):
            n_own = 0
            for row in range(len(residual)):
                if level[row] == at and sector[row] == part:
                    own[n_own] = residual[row]
                    n_own += 1
            if n_own:
                medians[n_medians] = np.median(own[:n_own])
                n_medians += 1
        shift[at] = np.median(medians[:n_medians])
    return shift


def steady_levels(local, fit, *, n_levels=16, min_points=6):
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
    residual = _residuals(local, fit.parameters)
    near = np.abs(residual) < 0.4 * fit.radius
    shift = _level_shifts(residual[near], level[near], sector[near], n_levels, min_points)
    known = np.flatnonzero(np.isfinite(shift))
    if len(known) < 6:
        return np.ones(len(local), dtype=bool)
    first, second = np.triu_indices(len(known), 1)
    slopes = (shift[known[second]] - shift[known[first]]) / (known[second] - known[first])
    deviation = shift - np.median(slopes) * np.arange(n_levels)
    deviation -= np.median(deviation[known])
    spread = _MAD_TO_SIGMA * np.median(np.abs(deviation[known]))
    allowed = max(3.0 * spread, 0.02 * fit.radius)
    is_steady = np.isnan(deviation) | (np.abs(deviation) <= allowed)
    return is_steady[level]


def bootstrap_radii(local, fit, n_samples, rng, *, n_sectors=12, n_levels=4):
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
    jacobian, damping = _linearised(points, fit.parameters, weights)
    weighted = jacobian * weights[:, None]
    normals = np.zeros((len(cells), 6, 6))
    gradients = np.zeros((len(cells), 6))
    np.add.at(normals, cell, weighted[:, :, None] * jacobian[:, None, :])
    np.add.at(gradients, cell, weighted * _residuals(points, fit.parameters)[:, None])
    drawn = rng.multinomial(len(cells), np.full(len(cells), 1.0 / len(cells)), n_samples)
    normal = np.einsum("sc,cij->sij", drawn, normals) + np.diag(damping)
    gradient = drawn @ gradients + damping * np.concatenate([np.zeros(3), fit.parameters[3:]])
    radii = fit.radius - np.linalg.solve(normal, gradient[:, :, None])[:, 2, 0]
    return radii[np.isfinite(radii) & (radii > 0.3 * fit.radius) & (radii < 3.0 * fit.radius)]


def arc_coverage(offset, n_sectors=N_SECTORS):
    """Degrees of a circle whose sectors hold a point; `offset` (n, 2) is relative to the centre."""
    return 360.0 * len(np.unique(_sector(offset, n_sectors))) / n_sectors


def _sector(offset, n_sectors):
    turn = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) + 0.5
    return np.minimum((turn * n_sectors).astype(int), n_sectors - 1)


def _sector_weights(offset):
    """Weights that even out the number of points per sector, at most by `_MAX_BALANCE`."""
    sector = _sector(offset, N_SECTORS)
    count = np.bincount(sector, minlength=N_SECTORS)
    typical = np.median(count[count > 0])
    return np.clip(typical / count[sector], 1.0 / _MAX_BALANCE, _MAX_BALANCE)


def _promising(miss, n=40):
    """The candidates with the least plain miss, best first."""
    return np.argsort(miss.sum(axis=0), kind="stable")[:n]


def _circles_through(triples):
    """Circles through three points each, (n, 3) of u, v, r; not finite where they are in line."""
    a, b, c = triples[:, 0], triples[:, 1], triples[:, 2]
    ab, ac = b - a, c - a
    cross = 2.0 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    ab2, ac2 = (ab**2).sum(axis=1), (ac**2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (ac[:, 1] * ab2 - ab[:, 1] * ac2) / cross
        v = (ab[:, 0] * ac2 - ac[:, 0] * ab2) / cross
    return np.column_stack([a[:, 0] + u, a[:, 1] + v, np.hypot(u, v)])


def _residuals(local, parameters):
    offset = local[:, :2] - parameters[:2] - local[:, 2:] * parameters[3:5]
    return np.hypot(offset[:, 0], offset[:, 1]) - parameters[2] - parameters[5] * local[:, 2]


def _tukey(residual, sigma):
    scaled = np.clip(np.abs(residual) / (_TUKEY * sigma), 0.0, 1.0)
    return (1.0 - scaled**2) ** 2


def _linearised(local, parameters, weights):
    """Jacobian of the residuals, and the damping that keeps a thin slab from tipping over."""
    offset = local[:, :2] - parameters[:2] - local[:, 2:] * parameters[3:5]
    unit = offset / np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-12)[:, None]
    jacobian = np.empty((len(local), 6))
    jacobian[:, :2] = -unit
    jacobian[:, 2] = -1.0
    jacobian[:, 3:5] = -unit * local[:, 2:]
    jacobian[:, 5] = -local[:, 2]
    extent = max(np.abs(local[:, 2]).max(), 1e-9)
    total = max(float(weights.sum()), 1e-12)
    return jacobian, total * np.array([*(1e-9,) * 3, *(1e-3 * extent**2,) * 3])


def _gauss_newton(local, parameters, residual, weights):
    """One weighted step; returns the new parameters and the largest move of centre or radius."""
    jacobian, damping = _linearised(local, parameters, weights)
    weighted = jacobian * weights[:, None]
    pull = np.concatenate([np.zeros(3), parameters[3:]])
    normal = weighted.T @ jacobian + np.diag(damping)
    step = -np.linalg.solve(normal, weighted.T @ residual + damping * pull)
    limit = 0.5 * abs(parameters[2])
    step[:3] = np.clip(step[:3], -limit, limit)
    return parameters + step, float(np.abs(step[:3]).max())
