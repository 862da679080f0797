"""Which photos to match with which: all, neighbours in name order, or those that look alike."""

import logging
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap
from scipy.cluster.vq import kmeans2, vq

from cherrypicker.sfm.database import image_ids

logger = logging.getLogger(__name__)

# Words of a scene, after Arandjelovic and Zisserman's 256 for any scene, and descriptors that they
# are learned from (guesses)
N_WORDS = 64
N_TRAINING_DESCRIPTORS = 60_000
# Features of a photo that its global descriptor is made of, the largest (guess)
N_FEATURES = 2000


def choose_pairs(
    database: Path, pairing: str, overlap: int, n_neighbors: int, seed: int
) -> list[tuple[str, str]]:
    """Choose the pairs of a database's photos, by name.

    Parameters
    ----------
    pairing : {"exhaustive", "sequential", "retrieval"}
        Retrieval adds the neighbours in name order.
    overlap : int
        As of :func:`sequential_pairs`.
    n_neighbors : int
        As of :func:`retrieval_pairs`.
    """
    ids = image_ids(database)
    names = list(ids)
    everyone = combinations(range(len(names)), 2)
    pairs = {*everyone} if pairing == "exhaustive" else sequential_pairs(len(names), overlap)
    if pairing == "retrieval":
        with pycolmap.Database.open(database) as opened:
            found = (opened.read_descriptors(image_id).data for image_id in ids.values())
            vectors = global_descriptors([np.array(each[-N_FEATURES:]) for each in found], seed)
        pairs |= retrieval_pairs(vectors, n_neighbors)
    n_all = len(names) * (len(names) - 1) // 2
    logger.info("%s pairing: %d of %d pairs of photos", pairing, len(pairs), n_all)
    return [(names[i], names[j]) for i, j in sorted(pairs)]


def sequential_pairs(n_photos: int, overlap: int) -> set[tuple[int, int]]:
    """Pair each photo with its next ``overlap`` ones, and with those 2, 4, 8 ... places on.

    The order is taken as closed, since an orbit ends where it began. The first index is smaller.
    """
    steps = {*range(1, overlap + 1), *(2**power for power in range(n_photos.bit_length()))}
    around = ((i, (i + step) % n_photos) for i in range(n_photos) for step in steps)
    return {(min(pair), max(pair)) for pair in around if pair[0] != pair[1]}


def retrieval_pairs(vectors: np.ndarray, n_neighbors: int) -> set[tuple[int, int]]:
    """Pair each photo with those whose global descriptors are the most alike, smaller index first.

    Parameters
    ----------
    vectors : ndarray of shape (n_photos, n_dimensions)
        Unit global descriptors, as :func:`global_descriptors` makes them.
    """
    similarity = vectors @ vectors.T
    np.fill_diagonal(similarity, -np.inf)
    n_neighbors = min(n_neighbors, len(vectors) - 1)
    nearest = np.argsort(-similarity, axis=1, kind="stable")[:, :n_neighbors]
    return {(min(i, j), max(i, j)) for i, row in enumerate(nearest.tolist()) for j in row}


def global_descriptors(descriptors: Sequence[np.ndarray], seed: int = 0) -> np.ndarray:
    """Describe each photo by one vector (VLAD [1]_) over words learned from these photos.

    Parameters
    ----------
    descriptors : sequence of ndarray of shape (n_features, 128), uint8
        SIFT descriptors (square-rooted, L1-normalised) of each photo; of any empty shape without.

    Returns
    -------
    ndarray of shape (n_photos, n_words * 128), float32
        Unit vectors; zero for a photo without features.

    References
    ----------
    .. [1] Arandjelovic, Zisserman, "All about VLAD", CVPR 2013.
    """
    units = [_normalised(each.reshape(-1, 128).astype(np.float32)) for each in descriptors]
    everything = np.concatenate(units)
    training = everything[:: len(everything) // N_TRAINING_DESCRIPTORS + 1]
    words, _ = kmeans2(training, min(N_WORDS, len(training)), minit="points", seed=seed)
    vectors = []
    for each in units:
        members = np.eye(len(words), dtype=np.float32)[vq(each, words)[0]]
        residuals = members.T @ each - members.sum(axis=0)[:, None] * words
        vectors.append(_normalised(residuals).ravel())
    return _normalised(np.stack(vectors))


def _normalised(rows: np.ndarray) -> np.ndarray:
    """Rows at unit length; those of zeros stay."""
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    return rows / np.where(length > 0, length, 1)
