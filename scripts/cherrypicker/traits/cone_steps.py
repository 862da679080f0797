"""Compiled steps of the robust cone fit: residuals, weights, normal equations, iterations.

A cone is six numbers, see `cherrypicker.traits.stem_fit.ConeFit`; points lie in its slab's frame.
"""

from __future__ import annotations

import numba
import numpy as np

from cherrypicker.geometry.ordering import median

__all__ = [
    "MAD_TO_SIGMA",
    "iterate_cone",
    "normal_sums",
    "radial_residuals",
    "tilt_damping",
    "tukey_weights",
]

MAD_TO_SIGMA = 1.4826
_TUKEY = 4.685  # 95 % efficiency on Gaussian residuals


@numba.njit(cache=True)
def iterate_cone(
    local: np.ndarray, parameters: np.ndarray, prior_weights: np.ndarray, n_iterations: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Parameters, residuals and their spread; the parameters are NaN without a solution."""
    first_radius = parameters[2]
    sigma = max(0.15 * first_radius, 1e-9)
    residual, near = radial_residuals(local, parameters), np.empty(len(local))
    for _ in range(n_iterations):
        weights = tukey_weights(residual, sigma)
        for row in range(len(weights)):
            weights[row] *= prior_weights[row]
        parameters, step = _gauss_newton(local, parameters, residual, weights)
        if not np.isfinite(step):
            break
        residual = radial_residuals(local, parameters)
        n_near = 0
        for row in range(len(residual)):
            if abs(residual[row]) < 3.0 * sigma:
                near[n_near] = abs(residual[row])
                n_near += 1
        if n_near < 6:
            break
        spread = MAD_TO_SIGMA * median(near[:n_near])
        # Shrinks towards the spread of the inliers by at most a third a step: a fast drop would
        # lock the fit onto the first guess.
        sigma = max(spread, 0.67 * sigma, 1e-4 * first_radius)
        if step < 1e-6 * first_radius and sigma <= 1.01 * max(spread, 1e-4 * first_radius):
            break
    return parameters, residual, sigma


@numba.njit(cache=True)
def radial_residuals(local: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Distances of points (n, 3) from a cone's surface, across its axis, outwards positive."""
    residual = np.empty(len(local))
    for row in range(len(local)):
        u, v, w = local[row, 0], local[row, 1], local[row, 2]
        u -= parameters[0] + w * parameters[3]
        v -= parameters[1] + w * parameters[4]
        residual[row] = np.sqrt(u * u + v * v) - parameters[2] - parameters[5] * w
    return residual


@numba.njit(cache=True)
def tukey_weights(residual: np.ndarray, sigma: float) -> np.ndarray:
    """Tukey's biweights of residuals that scatter by `sigma`, 0 to 1."""
    weights = np.empty(len(residual))
    for row in range(len(residual)):
        scaled = min(abs(residual[row]) / (_TUKEY * sigma), 1.0)
        weights[row] = (1.0 - scaled * scaled) * (1.0 - scaled * scaled)
    return weights


@numba.njit(cache=True)
def normal_sums(
    local: np.ndarray,
    parameters: np.ndarray,
    residual: np.ndarray,
    weights: np.ndarray,
    cell: np.ndarray,
    n_cells: int | np.int64,
) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrices (n_cells, 6, 6) and gradients (n_cells, 6) of the points of each cell."""
    normals, gradients = np.zeros((n_cells, 6, 6)), np.zeros((n_cells, 6))
    slope = np.empty(6)
    for row in range(len(local)):
        u, v, w = local[row, 0], local[row, 1], local[row, 2]
        u -= parameters[0] + w * parameters[3]
        v -= parameters[1] + w * parameters[4]
        away = max(np.sqrt(u * u + v * v), 1e-12)
        slope[0], slope[1], slope[2] = -u / away, -v / away, -1.0
        slope[3], slope[4], slope[5] = slope[0] * w, slope[1] * w, -w
        at = cell[row]
        for i in range(6):
            weighted = slope[i] * weights[row]
            gradients[at, i] += weighted * residual[row]
            for j in range(6):
                normals[at, i, j] += weighted * slope[j]
    return normals, gradients


@numba.njit(cache=True)
def tilt_damping(local: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """What keeps a thin slab from tipping over, (6,)."""
    extent, total = 1e-9, 0.0
    for row in range(len(local)):
        extent, total = max(extent, abs(local[row, 2])), total + weights[row]
    total, damping = max(total, 1e-12), np.empty(6)
    for i in range(6):
        damping[i] = 1e-9 * total if i < 3 else 1e-3 * (extent * extent) * total
    return damping


@numba.njit(cache=True)
def _gauss_newton(
    local: np.ndarray, parameters: np.ndarray, residual: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, float]:
    """One weighted step; returns the new parameters and the largest move of centre or radius.

    Both are NaN where the points leave the step open.
    """
    one = np.zeros(len(local), dtype=np.int64)
    normals, gradients = normal_sums(local, parameters, residual, weights, one, np.int64(1))
    damping = tilt_damping(local, weights)
    for i in range(6):
        normals[0, i, i] += damping[i]
        if i >= 3:
            gradients[0, i] += damping[i] * parameters[i]
    step, limit, largest = _solved(normals[0], gradients[0]), 0.5 * abs(parameters[2]), 0.0
    for i in range(6):
        if np.isnan(step[i]):
            largest = np.nan
        elif i < 3:
            step[i] = min(max(step[i], -limit), limit)
            largest = max(largest, abs(step[i]))
        step[i] = parameters[i] - step[i]
    return step, largest


@numba.njit(cache=True)
def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of symmetric equations by Cholesky's factors, NaN where they have none."""
    n, factor, found = len(right), np.zeros(matrix.shape), np.empty(len(right))
    for i in range(n):
        for j in range(i + 1):
            rest = 0.0
            for k in range(j):
                rest += factor[i, k] * factor[j, k]
            rest = matrix[i, j] - rest
            if i > j:
                factor[i, j] = rest / factor[j, j]
            elif rest > 0:
                factor[i, i] = np.sqrt(rest)
            else:
                for k in range(n):
                    found[k] = np.nan
                return found
    for i in range(n):
        rest = 0.0
        for k in range(i):
            rest += factor[i, k] * found[k]
        found[i] = (right[i] - rest) / factor[i, i]
    for i in range(n - 1, -1, -1):
        rest = 0.0
        for k in range(i + 1, n):
            rest += factor[k, i] * found[k]
        found[i] = (found[i] - rest) / factor[i, i]
    return found
