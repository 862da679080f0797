"""Semantic contraction whose weight follows the wood's thickness: our default preset.

The published contraction weighs all branches alike, so that what contracts a thick one pulls the
tips of thin ones in. Here the row of each point is weighted by the square of the local thickness,
which scales the smallest structure that the Laplacian keeps with the wood it lies on: two solves
contract a twig and a scaffold alike, and what is contracted already is left where it is. Class
weights (S) multiply it, for wood so thick that no neighbourhood reaches around it.
"""

import logging
import time

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.contraction.laplacian_published import semantic_row_weights, solve_contraction
from cherrypicker.contraction.laplacian_stars import star_laplacian
from cherrypicker.geometry.local_frames import neighborhood_axes, neighborhood_spread
from cherrypicker.geometry.sampling import voxel_thin

__all__ = ["contract_adaptively"]

logger = logging.getLogger(__name__)

N_SMOOTH = 8  # neighbours that the thickness is averaged over
DENSE_FACTOR = 8.0  # a cloud with this many points a site is contracted at its sites
LEAST_LINEARITY = 0.9
FLAT_FACTOR = 8.0  # a flat patch belongs to wood thicker than the patch is wide
REACH_IN_SPACINGS, FEWEST_NEAR = 2.2, 3
LEAST_REACH_IN_SITES = 1.5


def contract_adaptively(points, weights, options, callback=None):
    """Contract points, centred around the origin, by the scheme of this module.

    Iteration t solves [S D_t L; I] C' = [0; C] with ``D_t = initial_contraction *
    amplification^(t - 1) * diag(spread) / median(M_0)``: the spread is the mean squared distance
    of a point's neighbours from their main axis. L and the spread are computed anew from C' with
    the neighbours of the input.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    weights : ndarray of shape (n_points,) or None
        Lambda of each point's class.
    options : ContractionOptions
        ``initial_contraction``, ``amplification``, ``max_iterations``, ``n_neighbors``,
        ``termination_move`` and ``site_size`` are read.
    callback : callable, optional
        See `contract_points`.

    Returns
    -------
    points : ndarray of shape (n_points, 3), float64
    mass_ratio : list of float
    stop : str
    """
    sites, member = _sites(points, weights, options.site_size)
    of_site = None
    if weights is not None:
        of_site = np.empty(len(sites))
        of_site[member] = weights
    k = min(options.n_neighbors, len(sites) - 1)
    neighbors, n_near = _neighbors(sites, k, LEAST_REACH_IN_SITES * options.site_size)
    current, ratios, first_mass = sites, [], None
    stop = f"{options.max_iterations} iterations"
    start = time.perf_counter()
    L, mass = star_laplacian(current, neighbors)
    first_mass = float(np.median(mass[mass > 0])) if (mass > 0).any() else 1.0
    contraction = options.initial_contraction / first_mass
    for iteration in range(1, options.max_iterations + 1):
        spread, flatness = neighborhood_spread(current, neighbors, n_near)
        spread = _smoothed(spread * (1 + FLAT_FACTOR * flatness**2), neighbors)
        row = contraction * spread
        if of_site is not None:
            row = row * semantic_row_weights(L, of_site)
        new = solve_contraction(L, row, np.ones(len(current)), current)
        if not np.isfinite(new).all():
            raise RuntimeError("the solution is not finite")
        moved, current = np.linalg.norm(new - current, axis=1), new
        L, mass = star_laplacian(current, neighbors)
        ratios.append(float(np.mean(mass) / first_mass))
        logger.info(
            "iteration %d: mass ratio %.4f, moved %.2f mm (median), %.1f s so far",
            iteration,
            ratios[-1],
            1e3 * np.median(moved),
            time.perf_counter() - start,
        )
        if callback is not None:
            callback(iteration, ratios[-1], _along_axes(points, sites, member, current, neighbors))
        if moved.mean() < options.termination_move * np.sqrt(first_mass):
            stop = f"mean move below {options.termination_move:g} of the spacing"
            break
        contraction *= options.amplification
    return _along_axes(points, sites, member, current, neighbors), ratios, stop


def _sites(points, weights, size):
    """Where the equations are solved: voxel means of a dense cloud, else all points.

    Returns
    -------
    sites : ndarray of shape (n_sites, 3)
    member : ndarray of shape (n_points,), int64
        Site of each point.
    """
    groups = None if weights is None else np.unique(weights, return_inverse=True)[1]
    means, _, member = voxel_thin(points, size, groups)
    if len(points) < DENSE_FACTOR * len(means):
        return points, np.arange(len(points))
    logger.info("%d points contract at %d sites", len(points), len(means))
    return means, member


def _neighbors(points, k, least_reach):
    """The k nearest other points of each point, and how many of them are near.

    On a twig of one point a voxel, k neighbours reach so far that its bends look like thickness.

    Returns
    -------
    neighbors : ndarray of shape (n_points, k), int64
    n_near : ndarray of shape (n_points,), int64
    """
    distance, nearest = cKDTree(points).query(points, k=k + 1)
    own = nearest == np.arange(len(points))[:, None]
    # among points that coincide a point need not be its own first neighbour, nor among its own
    own[:, -1] |= ~own.any(axis=1)
    neighbors = nearest[~own].reshape(len(points), k)
    # in a cloud that is dense in places, the median spacing is not that of the sparse ones
    reach = max(REACH_IN_SPACINGS * float(np.median(distance[:, 1])), least_reach)
    n_near = np.count_nonzero(distance <= reach, axis=1) - 1
    return neighbors, np.clip(n_near, min(FEWEST_NEAR, k), k)


def _smoothed(values, neighbors):
    """Geometric mean over the nearest neighbours: the thin side of a junction keeps its own."""
    logarithm = np.log(np.maximum(values, np.finfo(float).tiny))
    near = neighbors[:, :N_SMOOTH]
    return np.exp((logarithm + logarithm[near].sum(axis=1)) / (1 + near.shape[1]))


def _along_axes(points, sites, member, contracted, neighbors):
    """Contracted position of every point: its own place on the axis that its site lies on.

    Contraction also moves points along a branch, tips inwards above all. Where the contracted
    neighbourhood is a line, each input point is projected to it.
    """
    axes, linearity = neighborhood_axes(contracted, neighbors)
    axes = np.where(linearity[:, None] > LEAST_LINEARITY, axes, 0.0)[member]
    along = np.einsum("ij,ij->i", points - contracted[member], axes)
    return contracted[member] + along[:, None] * axes
