"""Where the stem meets the ground: the height that a tree's heights are measured from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cherrypicker.classes import Label, wood_mask
from cherrypicker.geometry.robust import TUKEY, robust_sigma
from cherrypicker.skeleton.model import Skeleton

# Guesses, for stems of 2 to 30 cm
_GROUND_REACH_M = 0.6  # of the ground that counts around a stem, or so many of its radii
_GROUND_REACH_RADII = 5.0
_BARE_RADII = 1.3  # nearer than this it is hidden, or bark
_MIN_GROUND_POINTS = 50
_MAX_FOOT_STEP_M = 0.5  # that the ground lies over the lowest wood, or wood over the root
_BESIDE_RADII, _BESIDE_M = 3.0, 0.05  # of the root: wood of the stem
_LOWEST_SHARE = 0.01  # of that wood lies below its lowest point: noise
_N_SECTORS, _FEWEST_SECTORS = 8, 4  # around the stem, and those with ground that make a plane
# A robust plane: Tukey's biweight at 95 % efficiency, the median's scale of a normal distribution
_N_ROUNDS, _LEAST_SIGMA_M = 15, 1e-4


@dataclass
class Foot:
    """Where the stem meets the ground."""

    point: np.ndarray  # (3,): in the cloud's frame and unit; heights are measured from its z
    # ``ground`` (a plane fitted to the ground around the stem), ``wood`` (the lowest stem points,
    # where no ground was seen) or ``root`` (the skeleton's root, where neither was)
    source: str
    gap: float  # height of the lowest wood at the stem over the foot, in the cloud's unit
    # Standard error of the foot's height: none over ground, whose error the height's own holds (on
    # trees whose truth is known it does not follow how rough the ground is); without ground, how
    # far the lowest points lie from the skeleton's root; without either, the stem's radius.
    error: float


def find_foot(skeleton: Skeleton, points: np.ndarray, labels: np.ndarray) -> Foot:
    """Find the stem's foot: the ground below the root, or else the lowest points of the stem.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Whole labelled cloud, z up.
    labels : ndarray of shape (n_points,), uint8
    """
    root = skeleton.points[0]
    near_root = np.linalg.norm(skeleton.points - root, axis=1) < _GROUND_REACH_M
    radius = float(np.median(skeleton.radius[near_root]))
    wood = points[wood_mask(labels)]
    beside = np.hypot(*(wood[:, :2] - root[:2]).T) < max(_BESIDE_RADII * radius, _BESIDE_M)
    beside &= np.abs(wood[:, 2] - root[2]) < _MAX_FOOT_STEP_M
    low = float(np.quantile(wood[beside, 2], _LOWEST_SHARE)) if beside.any() else float(root[2])
    ground = points[labels == Label.GROUND]
    away = np.hypot(*(ground[:, :2] - root[:2]).T)
    reach = max(_GROUND_REACH_M, _GROUND_REACH_RADII * radius)
    ground = ground[(away > _BARE_RADII * radius) & (away < reach)]
    level = _ground_level(ground, root[:2])
    # A tree stands on the ground, however far up its lowest points lie; ground that lies well over
    # them is none (low branches of a scan without ground may pass for it)
    if level is None or (beside.any() and level - low > _MAX_FOOT_STEP_M):
        foot = np.array([root[0], root[1], low])
        if beside.any():
            return Foot(foot, "wood", 0.0, abs(low - float(root[2])))
        return Foot(foot, "root", 0.0, radius)
    foot = np.array([root[0], root[1], level])
    return Foot(foot, "ground", max(low - level, 0.0), 0.0)


def _ground_level(ground: np.ndarray, at: np.ndarray) -> float | None:
    """Height of a robust plane through the ground points at `at`; None with too few points."""
    if len(ground) < _MIN_GROUND_POINTS:
        return None
    offset = ground[:, :2] - at
    turn = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) + 0.5
    sector = (turn * _N_SECTORS).astype(int) % _N_SECTORS
    count = np.bincount(sector, minlength=_N_SECTORS)
    if (count > 0).sum() < _FEWEST_SECTORS:
        return float(np.median(ground[:, 2]))
    design = np.column_stack([np.ones(len(ground)), offset])
    balance = 1.0 / np.sqrt(count[sector])
    weights, plane = balance, np.zeros(3)
    for _ in range(_N_ROUNDS):
        root_weights = np.sqrt(weights)[:, None]
        plane = np.linalg.lstsq(
            design * root_weights, ground[:, 2] * root_weights[:, 0], rcond=None
        )[0]
        residual = ground[:, 2] - design @ plane
        sigma = max(robust_sigma(residual), _LEAST_SIGMA_M)
        weights = balance * (1.0 - np.clip(np.abs(residual) / (TUKEY * sigma), 0, 1) ** 2) ** 2
    return float(plane[0])
