"""Which photos see the same, and how the camera turned between them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from cherrypicker.capture.look import FEATURE_PX, Look
from cherrypicker.progress import in_threads
from cherrypicker.sfm.guided import MAX_RATIO
from cherrypicker.sfm.matching import MatchingOptions
from cherrypicker.sfm.pairs import retrieval_pairs

# Twice COLMAP's least inliers of a pair: on two scenes of known poses 95 % of the turns are right
# within 10 degrees from 30 on, below they may be anything
MIN_MATCHES = 30
# Of a relative pose, in pixels of the reduced photo; with 1.0 a scene of four passes for told whose
# azimuths are off by 30 degrees
_REACH_PX = 1.5


@dataclass
class Overlap:
    """A pair of photos that see the same."""

    # first, second: their places in the list
    first: int
    second: int
    n_matches: int  # features that both see and that agree on one motion of the camera
    turn: np.ndarray  # (3, 3) float64: rotation from the first camera's axes to the second's


def find_overlaps(looks: Sequence[Look], threads: int) -> list[Overlap]:
    """Match photos and keep the pairs whose matches fit one motion of the camera."""
    pairs = list(combinations(range(len(looks)), 2))
    if len(looks) > MatchingOptions.exhaustive_max_photos:
        words = [np.rint(512 * look.descriptors).clip(0, 255).astype(np.uint8) for look in looks]
        pairs = sorted(retrieval_pairs(words))
    found = in_threads(lambda pair: _match(looks, *pair), pairs, threads, "pairs matched")
    return [overlap for overlap in found if overlap]


def _match(looks: Sequence[Look], first: int, second: int) -> Overlap | None:
    one, two = looks[first], looks[second]
    if min(len(one.corners), len(two.corners)) < MIN_MATCHES:
        return None
    rows, columns = _mutual_matches(one.descriptors, two.descriptors)
    if len(rows) < MIN_MATCHES:
        return None
    here, there = one.corners[rows].astype(np.float64), two.corners[columns].astype(np.float64)
    reach = _REACH_PX / FEATURE_PX
    essential, inliers = cv2.findEssentialMat(
        here, there, np.eye(3), method=cv2.USAC_MAGSAC, threshold=reach
    )
    if essential is None or essential.shape != (3, 3) or inliers.sum() < MIN_MATCHES:
        return None
    count, turn, _, _ = cv2.recoverPose(essential, here, there, np.eye(3), mask=inliers)
    return Overlap(first, second, int(count), turn) if count >= MIN_MATCHES else None


def _mutual_matches(one: np.ndarray, two: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of features that are each other's nearest, and clearly nearer than the next."""
    likeness = one @ two.T
    best = likeness.argmax(axis=1)
    rows = np.arange(len(one))
    mutual = likeness.argmax(axis=0)[best] == rows
    top = likeness[rows, best]
    likeness[rows, best] = -1.0
    next_best = likeness.max(axis=1)
    # Squared distance of unit vectors is 2 - 2 times their product
    clear = 1.0 - top < MAX_RATIO**2 * (1.0 - next_best)
    keep = mutual & clear
    return rows[keep], best[keep]
