"""Pieces of a skeleton that are more likely not there are dropped, and kept on record.

A piece goes, with all that hangs on it, when more of its length is expected not to be there than to
be: a strand through the air has nothing beyond it, a bridge over a gap that was laid beside the
wood bears the wood beyond and stays.
"""

import logging
from typing import Any

import numpy as np

from cherrypicker.evidence.existence import Witnesses
from cherrypicker.files import rounded
from cherrypicker.geometry.tree_walks import sum_from_root
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.photo_check.places import STEP_PX, Places, places_along, step_of
from cherrypicker.skeleton.model import Skeleton

logger = logging.getLogger(__name__)


def drop_refuted(
    skeleton: Skeleton, photos: ScanPhotos, wood: np.ndarray, *, seed: int = 0
) -> tuple[Skeleton, dict]:
    """Drop the pieces of a skeleton that are more likely not there, by its photos.

    Parameters
    ----------
    photos : ScanPhotos
        In its frame.
    wood : ndarray of shape (n_wood, 3), float64
        Points of the cloud.

    Returns
    -------
    skeleton : Skeleton
        What is left.
    report : dict
        ``length``, and ``expected_length`` of what is there, before, ``dropped_length``, and
        ``pieces``, the longest first: ``length``, ``p_exists``, ``n_photos`` that speak against it
        (the median over its places), and ``edges``, each lower end, upper end, radius.
    """
    places = places_along(skeleton, step_of(skeleton, photos.poses))
    hung = places.points, places.radius, places.parent
    tree = Witnesses(photos, *hung, places.step / STEP_PX, wood, seed=seed).tree
    is_kept = _kept(skeleton, places, tree.probability)
    # Photos speak against a place where it is likelier without wood
    n_against = np.count_nonzero(tree.words < -np.log(2.0), axis=0)
    pieces = _pieces(skeleton, places, tree.probability, n_against, is_kept)
    dropped = sum(piece["length"] for piece in pieces)
    expected = float(tree.probability @ places.length)
    length = float(skeleton.edge_length.sum())
    logger.info(
        "by the photos %.2f of %.2f %s of skeleton are there; %d pieces of %.2f in all are dropped",
        expected,
        length,
        skeleton.unit,
        len(pieces),
        dropped,
    )
    return skeleton.select(is_kept), {
        "length": rounded(length),
        "expected_length": rounded(expected),
        "dropped_length": rounded(dropped),
        "pieces": pieces,
    }


def _kept(skeleton: Skeleton, places: Places, probability: np.ndarray) -> np.ndarray:
    """Which nodes stay: those of the subtree with the most expected wood over what is none."""
    n = len(skeleton)
    gain = np.bincount(places.node, (2.0 * probability - 1.0) * places.length, n)
    for node in range(n - 1, 0, -1):
        gain[skeleton.parent[node]] += max(gain[node], 0.0)
    gain[0] = 0.0  # the root stays
    return sum_from_root(skeleton.parent, (gain < 0).astype(np.float64)) == 0


def _pieces(
    skeleton: Skeleton,
    places: Places,
    probability: np.ndarray,
    n_against: np.ndarray,
    is_kept: np.ndarray,
) -> list[dict]:
    """What is dropped, piece by piece, the longest first."""
    piece = np.arange(len(skeleton))
    for node in np.flatnonzero(~is_kept):
        below = skeleton.parent[node]
        piece[node] = node if is_kept[below] else piece[below]
    found: list[dict[str, Any]] = []
    for first in np.unique(piece[~is_kept]):
        nodes = np.flatnonzero(piece == first)
        rows = piece[places.node] == first
        ends = skeleton.points[skeleton.parent[nodes]], skeleton.points[nodes]
        edges = np.column_stack([*ends, skeleton.radius[nodes]])
        found.append(
            {
                "length": rounded(places.length[rows].sum()),
                "p_exists": rounded(np.average(probability[rows], weights=places.length[rows])),
                "n_photos": int(np.median(n_against[rows])),
                "edges": np.round(edges, 6).tolist(),
            }
        )
    return sorted(found, key=lambda each: -each["length"])
