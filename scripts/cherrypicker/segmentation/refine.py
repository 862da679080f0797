"""Clean-up of the network's probabilities: neighbourhood vote and the trunk's connectedness."""

import logging
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.segmentation.spheres import voxel_sample

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Smoothing:
    """Parameters of the clean-up; lengths in metres of the tree's frame.

    Attributes
    ----------
    k : int
        Points that vote together, the point itself included; 0 or 1 leaves the network's result.
    trunk_gap_m : float
        Trunk points closer than this belong to one stem; it must span a calibration ring.
    trunk_base_height_m : float
        A stem starts at most this high above the ground, else it is branch.
    """

    k: int = 12
    trunk_gap_m: float = 0.25
    trunk_base_height_m: float = 0.5


def smooth_probabilities(points, probabilities, smoothing):
    """Mean probabilities over the nearest sampled points.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
    probabilities : ndarray of shape (n, n_classes), float32
    smoothing : Smoothing

    Returns
    -------
    ndarray of shape (n, n_classes), float32
    """
    k = min(smoothing.k, len(points))
    if k <= 1:
        return probabilities
    _, nearest = cKDTree(points).query(points, k=k)
    out = np.zeros_like(probabilities)
    for j in range(k):
        out += probabilities[nearest[:, j]]
    changed = (out.argmax(axis=1) != probabilities.argmax(axis=1)).mean()
    logger.info("vote of %d neighbours changed %.1f %% of the labels", k, 100 * changed)
    return out / k


def link_components(points, gap):
    """Groups of points that chains of steps shorter than about `gap` connect.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
    gap : float

    Returns
    -------
    ndarray of shape (n,), int
        Group of each point, 0 the largest group.

    Notes
    -----
    Linked on cells of a quarter of the gap, so the cost does not grow with the density.
    """
    if not len(points):
        return np.zeros(0, int)
    centers, inverse, _ = voxel_sample(points, gap / 4)
    pairs = cKDTree(centers).query_pairs(gap, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(centers),) * 2)
    _, group = connected_components(links, directed=False)
    group = group[inverse]
    sizes = np.bincount(group)
    rank = np.empty(len(sizes), int)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return rank[group]


def _ground_below(foot, ground):
    """Ground level under a point, from the ground points near it in x and y; 0 without any."""
    if len(ground) < 20:
        return 0.0
    distance = np.linalg.norm(ground[:, :2] - foot[:2], axis=1)
    nearest = np.argpartition(distance, 19)[:20]
    if distance[nearest].max() > 1.0:
        return 0.0
    return float(np.median(ground[nearest, 2]))


def clean_trunk(points, probabilities, smoothing):
    """Turn trunk islands that no stem connects to the ground into branch.

    The trunk class weighs ten times a branch in the contraction, so a false trunk costs more than
    a missed one.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        In the tree's frame, ground at about z = 0.
    probabilities : ndarray of shape (n, 7), float32
    smoothing : Smoothing

    Returns
    -------
    ndarray of shape (n, 7), float32
        A copy in which the trunk probability of the islands is added to branch.
    """
    labels = probabilities.argmax(axis=1)
    trunk = np.flatnonzero(labels == Label.TRUNK)
    if not len(trunk):
        return probabilities
    group = link_components(points[trunk], smoothing.trunk_gap_m)
    ground = points[labels == Label.GROUND]
    rooted = []
    for g in range(group.max() + 1):
        part = points[trunk[group == g]]
        lowest = part[part[:, 2] <= np.quantile(part[:, 2], 0.02)]
        foot = lowest.mean(axis=0)
        if foot[2] - _ground_below(foot, ground) <= smoothing.trunk_base_height_m:
            rooted.append(g)
    if not rooted:
        logger.warning("no trunk reaches the ground; the largest stem is kept")
        rooted = [0]
    island = trunk[~np.isin(group, rooted)]
    result = probabilities.copy()
    result[island, Label.BRANCH] += result[island, Label.TRUNK]
    result[island, Label.TRUNK] = 0.0
    logger.info(
        "%d stems reach the ground; %s of %s trunk points lay apart and became branch (%.1f %%)",
        len(rooted),
        f"{len(island):,}",
        f"{len(trunk):,}",
        100 * len(island) / len(trunk),
    )
    return result
