"""Height of the ground below a place, from the ground seen around it."""

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.geometry.robust import TUKEY, robust_sigma
from cherrypicker.geometry.sections import N_ROUNDS

# Of the ground around a stem that counts. With 0.3, 0.6 and 1.2 the heights of three scans are off
# by 9, 10 and 10 mm in the mean
REACH_M = 0.6
FEWEST_POINTS = 50
N_SECTORS, FEWEST_SECTORS = 8, 4  # around the stem, and those with ground that make a plane


def ground_height(
    xy: np.ndarray, ground: np.ndarray, fallback: float, n_nearest: int = 15
) -> np.ndarray:
    """Height of hilly ground below places (n, 2), (n,): median of what lies nearest in x and y.

    The ground, (n_ground, 3), are points or means of such; of hardly any, at most half of
    `n_nearest`, the height is the fallback.
    """
    ground = ground[:: max(1, len(ground) // 50_000)]
    if len(ground) <= n_nearest // 2:
        return np.full(len(xy), fallback)
    nearest = np.arange(1, 1 + min(n_nearest, len(ground)))
    _, index = cKDTree(ground[:, :2]).query(xy, k=nearest)
    return np.median(ground[index, 2], axis=1)


def ground_level(ground: np.ndarray, at: np.ndarray, radius: float) -> float | None:
    """Height of a robust plane through the ground (n, 3) around a stem, below its middle (2,).

    None with too few points. Tufts of grass beside a stem lift what lies nearest, not a plane.
    """
    away = np.hypot(*(ground[:, :2] - at).T)
    ground = ground[(away > radius) & (away < radius + REACH_M)]
    if len(ground) < FEWEST_POINTS:
        return None
    offset = ground[:, :2] - at
    turn = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) + 0.5
    sector = (turn * N_SECTORS).astype(int) % N_SECTORS
    count = np.bincount(sector, minlength=N_SECTORS)
    if (count > 0).sum() < FEWEST_SECTORS:
        return float(np.median(ground[:, 2]))
    return float(robust_plane(offset, ground[:, 2], 1.0 / np.sqrt(count[sector]))[0])


def robust_plane(xy: np.ndarray, z: np.ndarray, balance: np.ndarray | float = 1.0) -> np.ndarray:
    """Plane ``z = a + b x + c y`` through points (n, 2), (n,) by Tukey's biweight: a, b, c, (3,).

    `balance` are weights, (n,), beside those of the residuals.
    """
    design = np.column_stack([np.ones(len(xy)), xy])
    weights, plane = np.broadcast_to(balance, len(xy)), np.zeros(3)
    for _ in range(N_ROUNDS):
        root_weights = np.sqrt(weights)[:, None]
        plane = np.linalg.lstsq(design * root_weights, z * root_weights[:, 0], rcond=None)[0]
        residual = z - design @ plane
        limit = TUKEY * robust_sigma(residual) + np.finfo(float).tiny  # a plane may be perfect
        weights = balance * (1.0 - np.clip(np.abs(residual) / limit, 0, 1) ** 2) ** 2
    return plane
