"""What of a tree's wood is gone at another date, told from what the other scan did not see.

Wood that the other date lacks was cut, or its scan missed it. Each centimetre weighs: where the
other scan has no wood, by the logarithm of how seldom a scan misses wood of this radius, where it
has, by how seldom other wood stands in the place of what is gone. A cut takes all beyond it; cuts
are where the weights beyond add up to the most, less what a cut must bring to be believed (the best
closed set of a tree, by one walk from the tips). How often wood of a radius is missed is counted on
the pair itself, on what is not gone, and the search repeated.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.series.wood import PIECE_M, Wood

# Upper ends of classes of radius; the share of their wood that a scan misses before any was counted
# (measured on generated pairs, docs/lab/series.md) and the length that this is worth
CLASSES_M = np.array([0.002, 0.003, 0.004, 0.006, 0.010])
USUALLY_MISSED = np.array([0.20, 0.08, 0.04, 0.02, 0.01, 0.01])
WORTH_M = 3.0
STANDS_THERE = 0.03  # share of gone wood in whose place is other wood (measured, as above)
# That must speak for a cut, to one: some hundreds of twigs could be missed. With 20 to 100 cuts are
# the same in eight pairs, with 2 two more are false, with 400 two less are right of 32. As many for
# wood that hung on what is gone in the earlier skeleton alone, which joined it to a wrong limb
ODDS = 200.0
ROUNDS = 4
# Cosine from which on points lie behind wood; with 0 the removed volume of 8 pairs is 4 % too large
BEHIND = -0.5


@dataclass
class Gone:
    """Wood that the other date lacks."""

    first: np.ndarray  # (n_cuts,) int64: the samples that the gone pieces start with
    piece: np.ndarray  # (n,) int64: which of them a sample belongs to, -1 for what is there


def seen_by(wood: Wood, places: np.ndarray, cloud: np.ndarray, reach: float) -> np.ndarray:
    """Whether a scan has points of wood near where samples are, (n,) bool.

    `places` (n, 3) are the samples' in the scan's frame, `cloud` (m, 3) its points of wood, which
    may lie `reach` metres off, besides the wood's radius.
    """
    distance, _ = cKDTree(cloud).query(places, distance_upper_bound=reach + wood.radius.max())
    return distance <= reach + wood.radius


def find_gone(wood: Wood, is_there: np.ndarray) -> Gone:
    """Find what was cut off, by whether the other date has wood in a sample's place, (n,) bool."""
    missed = USUALLY_MISSED[np.searchsorted(CLASSES_M, wood.radius)]
    for _ in range(ROUNDS):
        weights = wood.length / PIECE_M * odds_of_gone(is_there, missed)
        gone = _best_cuts(wood, weights, np.log(ODDS), np.log(ODDS))
        missed = share_missed(wood, is_there, gone.piece < 0)
    return gone


def share_missed(wood: Wood, is_there: np.ndarray, is_left: np.ndarray) -> np.ndarray:
    """How often the other scan misses wood as thin as a sample's, (n,) float64.

    Counted on the wood that is at both dates.
    """
    row = np.searchsorted(CLASSES_M, wood.radius)
    left = wood.length * is_left
    total = np.bincount(row, left, len(USUALLY_MISSED))
    unseen = np.bincount(row, left * ~is_there, len(USUALLY_MISSED))
    return ((USUALLY_MISSED * WORTH_M + unseen) / (WORTH_M + total))[row]


def odds_of_gone(is_there: np.ndarray, missed: np.ndarray | float) -> np.ndarray:
    """Log odds of a piece that the other date lacks it, by whether it was seen, (n,) float64."""
    return np.where(is_there, np.log(STANDS_THERE), -np.log(missed))


def reach_back(wood: Wood, gone: Gone, places: np.ndarray, cloud: np.ndarray, most: float) -> Gone:
    """Bring cuts back to where the other scan's wood ends.

    What lies a little beyond the end of a stub has the stub's points near it. Such wood has its
    nearest points behind it, wood that is there has them at its sides. Places and cloud are as of
    `seen_by`; a cut is brought back by `most` metres at most, besides the wood's radius.
    """
    if not len(cloud):
        return gone
    points = cKDTree(cloud)
    first, piece = gone.first.copy(), gone.piece.copy()
    for number, start in enumerate(gone.first):
        row = wood.parent[start]
        while wood.axis[row] == wood.axis[start] and piece[row] < 0 and wood.parent[row] >= 0:
            distance, nearest = points.query(places[row])
            step = places[row] - places[wood.parent[row]]
            ahead = (cloud[nearest] - places[row]) @ step
            is_beside = ahead > BEHIND * distance * np.linalg.norm(step)
            if is_beside or distance > most + wood.radius[row]:
                break
            first[number], piece[row] = row, number
            row = wood.parent[row]
    return Gone(first, piece)


def find_new(wood: Wood, was_there: np.ndarray, least_length: float) -> Gone:
    """Find what has grown: wood that the earlier date lacks, up to the tips.

    Every tip grows in a year, so that no odds are asked for, only a length.
    """
    weights = wood.length / PIECE_M * odds_of_gone(was_there, STANDS_THERE)
    return _best_cuts(wood, weights, least_length / PIECE_M * -np.log(STANDS_THERE))


def _best_cuts(wood: Wood, weights: np.ndarray, least: float, back: float = np.inf) -> Gone:
    """Tell what is gone: what weighs most, less `least` a cut and `back` a return to what is there.

    Viterbi's recursion on a tree: the best sums over what is beyond a sample, for both of its
    states, from the tips down; then the states, from the root up.
    """
    n, parent = len(wood), wood.parent
    there, gone = np.zeros(n), weights.copy()
    for row in range(n - 1, 0, -1):  # the tree's first sample stays
        there[parent[row]] += max(there[row], gone[row] - least)
        gone[parent[row]] += max(gone[row], there[row] - back)
    piece = np.full(n, -1)
    first: list[int] = []
    for row in range(1, n):
        below = piece[parent[row]]
        if below >= 0:
            piece[row] = below if gone[row] >= there[row] - back else -1
        elif gone[row] - least > there[row]:
            piece[row] = len(first)
            first.append(row)
    return Gone(np.array(first, dtype=np.int64), piece)
