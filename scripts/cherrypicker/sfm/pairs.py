"""Which photos to match with which where not all are: neighbours in name order, or look-alikes."""

from collections.abc import Sequence

import numpy as np

# Where not all photos are matched with all, each is with the most similar, and with the next ones
# in name order; and one that needs more matches with so many anew (guesses)
N_ALIKE = 30
N_PARTNERS = 8
# Words of a scene, Arandjelovic and Zisserman's number
N_WORDS = 256
# Descriptors that they are learned from; half and twice as many find the same partners on three
# scans, to 1 % of the matches
N_TRAINING_DESCRIPTORS = 60_000


def sequential_pairs(n_photos: int) -> set[tuple[int, int]]:
    """Pair each photo with its next `N_PARTNERS` ones, and with those 2, 4, 8 ... places on.

    The order is taken as closed, since an orbit ends where it began. The first index is smaller.
    """
    steps = {*range(1, N_PARTNERS + 1), *(2**power for power in range(n_photos.bit_length()))}
    around = ((i, (i + step) % n_photos) for i in range(n_photos) for step in steps)
    return {(min(pair), max(pair)) for pair in around if pair[0] != pair[1]}


def retrieval_pairs(descriptors: Sequence[np.ndarray], seed: int = 0) -> set[tuple[int, int]]:
    """Pair each photo with the `N_ALIKE` whose global descriptors are most like, smaller first.

    The descriptors are as of :func:`global_descriptors`.
    """
    vectors = global_descriptors(descriptors, seed)
    similarity = vectors @ vectors.T
    np.fill_diagonal(similarity, -np.inf)
    n_alike = min(N_ALIKE, len(vectors) - 1)
    nearest = np.argsort(-similarity, axis=1, kind="stable")[:, :n_alike]
    return {(min(i, j), max(i, j)) for i, row in enumerate(nearest.tolist()) for j in row}


def global_descriptors(descriptors: Sequence[np.ndarray], seed: int = 0) -> np.ndarray:
    """Describe each photo by one vector over words learned from these photos.

    It is the VLAD of Arandjelovic and Zisserman ("All about VLAD", CVPR 2013) of SIFT descriptors
    (square-rooted, L1-normalised), (n_features, 128) uint8 a photo, of any empty shape without. The
    vectors (n_photos, n_words * 128), float32, are units; zero for a photo without features.
    """
    from scipy.cluster.vq import kmeans2, vq  # the forecast, which reads the numbers, has no time

    photos = [each.reshape(-1, 128) for each in descriptors]
    everything = np.concatenate(photos)
    training = everything[:: len(everything) // N_TRAINING_DESCRIPTORS + 1]
    training = _normalised(training.astype(np.float32))
    words, _ = kmeans2(training, min(N_WORDS, len(training)), minit="points", seed=seed)
    vectors = []
    for photo in photos:
        units = _normalised(photo.astype(np.float32))
        members = np.eye(len(words), dtype=np.float32)[vq(units, words)[0]]
        residuals = members.T @ units - members.sum(axis=0)[:, None] * words
        vectors.append(_normalised(residuals).ravel())
    return _normalised(np.stack(vectors))


def _normalised(rows: np.ndarray) -> np.ndarray:
    """Rows at unit length; those of zeros stay."""
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    return rows / np.where(length > 0, length, 1)
