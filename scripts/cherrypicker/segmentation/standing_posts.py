"""Support posts in wood that the network did not call trunk.

A thin or smooth post passes for a branch, and `support_post` looks at trunk points alone. Here
every column of wood that rises from the ground is tried, whatever its class: what is a post by the
same measures, and has another column beside it that is none, is split off.
"""

from __future__ import annotations

import logging

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label, wood_mask
from cherrypicker.geometry.sampling import voxel_sample
from cherrypicker.segmentation.refine import link_components
from cherrypicker.segmentation.spheres import TreeFrame
from cherrypicker.segmentation.support_post import PostModel, graded_posts, label_post

__all__ = ["split_standing_posts", "standing_columns"]

logger = logging.getLogger(__name__)

# Guesses, looked at on a dozen generated scenes with posts
BAND_M = (0.08, 0.58)  # heights above the ground in which a column must stand
STEP_M = 0.05
GAP_M = 0.03
MIN_STEPS = 0.8  # of the band's steps, occupied
BESIDE_M = 0.6  # a post stands this near to the stem that it supports
CORE_M = 0.10  # half width of a column's wood at its foot
SPREAD = 0.04  # and what it widens by a metre of height
GROUND_VOXEL_M = 0.1  # the ground below a column is looked up on
_MAX_COLUMNS = 24  # the largest; bounds the time


def standing_columns(wood: np.ndarray, ground: np.ndarray) -> list[np.ndarray]:
    """Columns of wood that rise from the ground.

    Parameters
    ----------
    wood : ndarray of shape (n, 3), float64
        Metres, z up.
    ground : ndarray of shape (m, 3), float64
        Points of the ground, at least one.

    Returns
    -------
    list of ndarray of shape (k, 3)
        The part of each column in the band of heights `BAND_M`, the largest first.
    """
    level = ground[cKDTree(ground[:, :2]).query(wood[:, :2], workers=1)[1], 2]
    height = wood[:, 2] - level
    low, high = BAND_M
    inside = (height > low) & (height < high)
    points, height = wood[inside], height[inside]
    group = link_components(points, GAP_M)
    columns = []
    for g in range(min(int(group.max()) + 1 if len(group) else 0, 4 * _MAX_COLUMNS)):
        steps = np.unique(np.floor((height[group == g] - low) / STEP_M))
        if len(steps) >= MIN_STEPS * (high - low) / STEP_M:
            columns.append(points[group == g])
    return columns[:_MAX_COLUMNS]


def _around(wood: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Wood (rows) about the line that a column's foot sets out on."""
    x, y, z = column.T
    slope = np.polynomial.polynomial.polyfit(z, np.stack([x, y], axis=1), 1)  # (2, 2)
    middle = slope[0] + wood[:, 2:3] * slope[1]
    reach = CORE_M + SPREAD * np.maximum(wood[:, 2] - z.min(), 0.0)
    return np.linalg.norm(wood[:, :2] - middle, axis=1) < reach


def split_standing_posts(
    points: np.ndarray, labels: np.ndarray, frame: TreeFrame, model: PostModel, seed: int = 0
) -> np.ndarray:
    """Give posts that pass for branches their own label.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        In the cloud's frame.
    labels : ndarray of shape (n,), uint8
        After `cherrypicker.segmentation.support_post.split_support_post`.
    frame : cherrypicker.segmentation.spheres.TreeFrame
        Only its origin enters.
    model : cherrypicker.segmentation.support_post.PostModel
    seed : int

    Returns
    -------
    ndarray of shape (n,), uint8
        A copy. Of the columns that stand side by side one stays wood at least.
    """
    labels = labels.copy()
    local = points - frame.origin
    ground = local[labels == Label.GROUND]
    is_wood = wood_mask(labels)
    if not len(ground) or not is_wood.any():
        return labels
    wood = local[is_wood]
    columns = standing_columns(wood, voxel_sample(ground, GROUND_VOXEL_M)[0])
    feet = np.array([column[:, :2].mean(axis=0) for column in columns]).reshape(-1, 2)
    apart = np.linalg.norm(feet[:, None] - feet[None], axis=2)
    graded = []
    for i, column in enumerate(columns):
        beside = np.flatnonzero((apart[i] < BESIDE_M) & (np.arange(len(columns)) != i))
        if not len(beside):
            continue
        others = np.concatenate([columns[j] for j in beside])
        part = wood[_around(wood, column)]
        posts = graded_posts(part, model, seed, wood, beside=others)
        graded += [(grade, i, post) for grade, post in posts[:1]]
    is_post = np.zeros(len(columns), bool)
    for _, i, post in sorted(graded, key=lambda entry: entry[0]):
        near = (apart[i] < BESIDE_M) & (np.arange(len(columns)) != i)
        if (near & ~is_post).any():
            is_post[i] = True
            n = label_post(local, labels, post, model)
            logger.info(
                "support post among the branches: %.0f mm diameter, %.2f to %.2f m, %s points",
                2000 * post.radius, post.low, post.high, f"{n:,}",
            )  # fmt: skip
    return labels
