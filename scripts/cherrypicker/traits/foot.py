"""Where the stem meets the ground: the height that a tree's heights are measured from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cherrypicker.classes import Label, wood_mask
from cherrypicker.skeleton.model import Skeleton

__all__ = ["Foot", "find_foot"]

_GROUND_REACH_M = 0.6
_MIN_GROUND_POINTS = 50
_MAX_FOOT_STEP_M = 0.5
_FOOT_ERROR = 1.4  # of the foot over the scatter of the ground around it; docs/traits.md


@dataclass
class Foot:
    """Where the stem meets the ground.

    Attributes
    ----------
    point : ndarray of shape (3,)
        In the cloud's frame and unit; heights are measured from its z.
    source : str
        ``ground`` (a plane fitted to the ground around the stem), ``wood`` (the lowest stem
        points, where no ground was seen) or ``root`` (the skeleton's root, where neither was).
    gap : float
        Height of the lowest wood at the stem over the foot, in the cloud's unit.
    error : float
        Standard error of the foot's height. The ground under the stem is not seen: it may lie as
        far off the plane as the ground around it does. Without ground, how far the lowest points
        lie from the skeleton's root; without either, the stem's radius.
    """

    point: np.ndarray
    source: str
    gap: float
    error: float


def find_foot(skeleton: Skeleton, points: np.ndarray, labels: np.ndarray) -> Foot:
    """Find the stem's foot: the ground below the root, or else the lowest points of the stem.

    Parameters
    ----------
    skeleton : Skeleton
    points : ndarray of shape (n_points, 3), float64
        Whole labelled cloud, z up.
    labels : ndarray of shape (n_points,), uint8

    Returns
    -------
    Foot
    """
    root = skeleton.points[0]
    near_root = np.linalg.norm(skeleton.points - root, axis=1) < _GROUND_REACH_M
    radius = float(np.median(skeleton.radius[near_root]))
    wood = points[wood_mask(labels)]
    beside = np.hypot(*(wood[:, :2] - root[:2]).T) < max(3.0 * radius, 0.05)
    beside &= np.abs(wood[:, 2] - root[2]) < _MAX_FOOT_STEP_M
    low = float(np.quantile(wood[beside, 2], 0.01)) if beside.any() else float(root[2])
    ground = points[labels == Label.GROUND]
    away = np.hypot(*(ground[:, :2] - root[:2]).T)
    ground = ground[(away > 1.3 * radius) & (away < max(_GROUND_REACH_M, 5.0 * radius))]
    level, scatter = _ground_level(ground, root[:2])
    if level is None or (beside.any() and abs(level - low) > _MAX_FOOT_STEP_M):
        foot = np.array([root[0], root[1], low])
        if beside.any():
            return Foot(foot, "wood", 0.0, abs(low - float(root[2])))
        return Foot(foot, "root", 0.0, radius)
    foot = np.array([root[0], root[1], level])
    return Foot(foot, "ground", max(low - level, 0.0), _FOOT_ERROR * scatter)


def _ground_level(ground: np.ndarray, at: np.ndarray) -> tuple:
    """Height of a robust plane through the ground points at `at`, and their scatter around it.

    The height is None with too few points.
    """
    if len(ground) < _MIN_GROUND_POINTS:
        return None, 0.0
    offset = ground[:, :2] - at
    sector = ((np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) + 0.5) * 8).astype(int) % 8
    count = np.bincount(sector, minlength=8)
    if (count > 0).sum() < 4:
        middle = np.median(ground[:, 2])
        return float(middle), float(1.4826 * np.median(np.abs(ground[:, 2] - middle)))
    design = np.column_stack([np.ones(len(ground)), offset])
    balance = 1.0 / np.sqrt(count[sector])
    weights, plane = balance, np.zeros(3)
    for _ in range(15):
        root_weights = np.sqrt(weights)[:, None]
        plane = np.linalg.lstsq(
            design * root_weights, ground[:, 2] * root_weights[:, 0], rcond=None
        )[0]
        residual = ground[:, 2] - design @ plane
        sigma = max(1.4826 * np.median(np.abs(residual)), 1e-4)
        weights = balance * (1.0 - np.clip(np.abs(residual) / (4.685 * sigma), 0, 1) ** 2) ** 2
    return float(plane[0]), float(sigma)
