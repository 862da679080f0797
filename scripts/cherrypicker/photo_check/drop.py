"""Pieces of a skeleton that are more likely not there are dropped, and kept on record.

A piece goes, with all that hangs on it, when more of its length is expected not to be there than to
be: a strand through the air has nothing beyond it, a bridge over a gap that was laid beside the
wood bears the wood beyond and stays.
"""

import logging
from typing import Any

import numpy as np

from cherrypicker.files import rounded
from cherrypicker.geometry.tree_walks import sum_from_root
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.photo_check.places import Places, ask_places
from cherrypicker.skeleton.model import Skeleton

logger = logging.getLogger(__name__)


def drop_refuted(
    skeleton: Skeleton, photos: ScanPhotos, wood: np.ndarray, *, seed: int = 0
) -> tuple[Skeleton, dict]:
    """Drop the pieces of a skeleton that are more likely not there, by its photos.

    They and ``wood`` (n_wood, 3), points of the cloud, are in its frame. Returns what is left and a
    report: ``length``, and ``expected_length`` of what is there, before, ``dropped_length``, and
    ``pieces``, the longest first: ``length``, ``p_exists``, ``n_photos`` that speak against it (the
    median over its places), and ``edges``, each lower end, upper end, radius.
    """
    places, witnesses = ask_places(skeleton, photos, wood, seed)
    tree = witnesses.tree
    is_kept = _kept(skeleton, places, tree.probability)
    # Photos speak against a place where it is likelier without wood
    n_against = np.count_nonzero(tree.words < -np.log(2.0), axis=0)
    piece = np.arange(len(skeleton))
    for node in np.flatnonzero(~is_kept):
        below = skeleton.parent[node]
        piece[node] = node if is_kept[below] else piece[below]
    pieces: list[dict[str, Any]] = []
    for first in np.unique(piece[~is_kept]):
        nodes = np.flatnonzero(piece == first)
        rows = piece[places.node] == first
        there, length = tree.probability[rows], places.length[rows]
        ends = skeleton.points[skeleton.parent[nodes]], skeleton.points[nodes]
        edges = np.column_stack([*ends, skeleton.radius[nodes]])
        pieces.append(
            {
                "length": rounded(length.sum()),
                "p_exists": rounded(np.average(there, weights=length)),
                "n_photos": int(np.median(n_against[rows])),
                "edges": np.round(edges, 6).tolist(),
            }
        )
    pieces.sort(key=lambda each: -each["length"])
    dropped = sum(each["length"] for each in pieces)
    expected = float(tree.probability @ places.length)
    whole = float(skeleton.edge_length.sum())
    logger.info(
        f"by the photos {expected:.2f} of {whole:.2f} {skeleton.unit} of skeleton are there; "
        f"{len(pieces)} pieces of {dropped:.2f} in all are dropped"
    )
    return skeleton.select(is_kept), {
        "length": rounded(whole),
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
