"""Clean-up of the network's probabilities: neighbourhood vote, false roofs, trunk islands."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.geometry.sampling import voxel_sample
from cherrypicker.wood.gaps import GAP_M

logger = logging.getLogger(__name__)

# Sheets: guesses, held against the laser scans of docs/segmentation.md
SHEET_REACH_M = 0.2  # a roof is flat over this distance
SHEET_STEP_M = 0.04  # cells that its shape is taken from
MAX_THICKNESS = 0.05  # least variance of a sheet's points, as a share of all of it
MIN_BREADTH = 0.15  # middle variance, as a share of the largest; a rod has none
MIN_SHEET_CELLS = 6
UPRIGHT = 0.966  # cosine of 15 degrees: a roof's posts stand no less upright (a guess)
SHEET_GAP_M = 0.12  # cells this near to one another are one piece of roof
MIN_FLAT = 0.5  # share of a piece's cells, and of those around a cell, that are flat
N_AROUND = 9  # cells around one, itself counted
# The ground below a piece of trunk (guesses): points that tell it, how near, and the piece's foot
N_GROUND, GROUND_REACH_M, LOWEST = 20, 1.0, 0.02
CELLS_IN_GAP = 4  # cells that components are linked on, in a gap


@dataclass(frozen=True)
class Smoothing:
    """Parameters of the clean-up; the fields are config keys of ``segment``."""

    smooth_k: int = 12  # without the vote the mean IoU of foreign_a falls from 0.695 to 0.660
    trunk_gap_m: float = GAP_M
    trunk_base_height_m: float = 0.5


def smooth_probabilities(
    points: np.ndarray, probabilities: np.ndarray, smoothing: Smoothing
) -> np.ndarray:
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
    k = min(smoothing.smooth_k, len(points))
    if k <= 1:
        return probabilities
    _, nearest = cKDTree(points).query(points, k=k)
    out = np.zeros_like(probabilities)
    for j in range(k):
        out += probabilities[nearest[:, j]]
    changed = (out.argmax(axis=1) != probabilities.argmax(axis=1)).mean()
    logger.info("vote of %d neighbours changed %.1f %% of the labels", k, 100 * changed)
    return out / k


def link_components(points: np.ndarray, gap: float) -> np.ndarray:
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
    centers, inverse, _ = voxel_sample(points, gap / CELLS_IN_GAP)
    pairs = cKDTree(centers).query_pairs(gap, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(centers),) * 2)
    _, group = connected_components(links, directed=False)
    group = group[inverse]
    sizes = np.bincount(group)
    rank = np.empty(len(sizes), int)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return rank[group]


def ground_below(foot: np.ndarray, ground: np.ndarray) -> float:
    """Ground level under a point, from the ground points near it in x and y; 0 without any."""
    if len(ground) < N_GROUND:
        return 0.0
    distance = np.linalg.norm(ground[:, :2] - foot[:2], axis=1)
    nearest = np.argpartition(distance, N_GROUND - 1)[:N_GROUND]
    if distance[nearest].max() > GROUND_REACH_M:
        return 0.0
    return float(np.median(ground[nearest, 2]))


def clean_trunk(points: np.ndarray, probabilities: np.ndarray, smoothing: Smoothing) -> np.ndarray:
    """Turn trunk islands that no stem connects to the ground into branch.

    An island high up is straight wood that would pass for a post, and a false stem.

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
    channel = probabilities.argmax(axis=1)
    trunk = np.flatnonzero(channel == Label.TRUNK.channel)
    if not len(trunk):
        return probabilities
    group = link_components(points[trunk], smoothing.trunk_gap_m)
    ground = points[channel == Label.GROUND.channel]
    rooted = []
    for g in range(group.max() + 1):
        part = points[trunk[group == g]]
        lowest = part[part[:, 2] <= np.quantile(part[:, 2], LOWEST)]
        foot = lowest.mean(axis=0)
        if foot[2] - ground_below(foot, ground) <= smoothing.trunk_base_height_m:
            rooted.append(g)
    if not rooted:
        logger.warning("no trunk reaches the ground; the largest stem is kept")
        rooted = [0]
    island = trunk[~np.isin(group, rooted)]
    result = probabilities.copy()
    result[island, Label.BRANCH.channel] += result[island, Label.TRUNK.channel]
    result[island, Label.TRUNK.channel] = 0.0
    logger.info(
        "%d stems reach the ground; %s of %s trunk points lay apart and became branch (%.1f %%)",
        len(rooted),
        f"{len(island):,}",
        f"{len(trunk):,}",
        100 * len(island) / len(trunk),
    )
    return result


def _is_sheet_or_post(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which points (n, 3) lie in a flat patch, and which in an upright rod.

    By the variances within `SHEET_REACH_M`.
    """
    pairs = cKDTree(cells).query_pairs(SHEET_REACH_M, output_type="ndarray")
    own = np.arange(len(cells))
    i = np.concatenate([own, pairs[:, 0], pairs[:, 1]])
    j = np.concatenate([own, pairs[:, 1], pairs[:, 0]])
    n = np.bincount(i, minlength=len(cells))
    offset = cells[j] - cells[i]
    moments = np.empty((len(cells), 3, 3))
    mean = np.stack([np.bincount(i, offset[:, a], len(cells)) / n for a in range(3)], axis=1)
    for a in range(3):
        for b in range(a, 3):
            second = np.bincount(i, offset[:, a] * offset[:, b], len(cells)) / n
            moments[:, a, b] = moments[:, b, a] = second - mean[:, a] * mean[:, b]
    variances, ways = np.linalg.eigh(moments, UPLO="U")
    low, middle, high = variances.clip(0.0).T
    is_known = n >= MIN_SHEET_CELLS
    is_broad = middle >= MIN_BREADTH * high
    is_flat = low <= MAX_THICKNESS * (low + middle + high)
    is_upright = np.abs(ways[:, 2, 2]) >= UPRIGHT
    return is_flat & is_broad & is_known, is_upright & ~is_broad & is_known


def keep_sheets(points: np.ndarray, probabilities: np.ndarray) -> np.ndarray:
    """Take the class roof from what is no sheet, such as the dense crown of a laser scan.

    Roofs and nets are sheets, and upright posts carry them. Of each connected piece of roof half
    must be either, and some of it flat, else all of it goes to the likeliest other class; of a
    piece that stays, so do the points off the sheet and its posts.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        In the tree's frame.
    probabilities : ndarray of shape (n, 7), float32

    Returns
    -------
    ndarray of shape (n, 7), float32
        A copy with a roof probability of 0 where there is no sheet.
    """
    roof = np.flatnonzero(probabilities.argmax(axis=1) == Label.ROOF.channel)
    if not len(roof):
        return probabilities
    cells, cell_of, _ = voxel_sample(points[roof], SHEET_STEP_M)
    flat, post = _is_sheet_or_post(cells)
    piece = link_components(cells, SHEET_GAP_M)
    share = np.bincount(piece, flat | post) / np.bincount(piece)
    is_roof = (share >= MIN_FLAT) & (np.bincount(piece, flat) >= MIN_SHEET_CELLS)
    # what touches a sheet bends its patch a little: the neighbours' mean decides
    near = cKDTree(cells).query(cells, k=min(N_AROUND, len(cells)))[1].reshape(len(cells), -1)
    stays = is_roof[piece] & ((flat | post)[near].mean(axis=1) >= MIN_FLAT)
    lost = roof[~stays[cell_of]]
    result = probabilities.copy()
    result[lost, Label.ROOF.channel] = 0.0
    result[lost, Label.BRANCH.channel] += 1e-6  # what the network is certain of is wood then
    result[lost] /= result[lost].sum(axis=1, keepdims=True)
    logger.info(
        "%s of %s roof points lie in no sheet and became another class",
        f"{len(lost):,}",
        f"{len(roof):,}",
    )
    return result
