"""Pieces of a skeleton that the photos refute are dropped, and kept on record.

A piece goes, with all that hangs on it, when photos refute more of it than they leave: a strand
through the air has nothing beyond it, a bridge over a gap that was laid beside the wood bears the
wood beyond and stays. So does a tree of which they refute more than they leave: there the photos
do not fit.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from cherrypicker.files import rounded
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.photo_check.places import MetricWorkspace, Places, places_along, step_of
from cherrypicker.photo_check.votes import Votes, clear_skies, judge, stands_out, vote
from cherrypicker.skeleton.model import Skeleton

__all__ = ["DropOptions", "drop_refuted"]

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class DropOptions:
    """What is dropped; the fields are config keys of ``photo_check``.

    Attributes
    ----------
    drop_refuted : bool
        Whether anything is.
    least_photos : int
        Photos that must say something about a place, and that must show clear sky to refute it.
    """

    drop_refuted: bool = True
    least_photos: int = 2


def drop_refuted(
    skeleton: Skeleton, workspace: MetricWorkspace, masks: SkyMasks, least_photos: int
) -> tuple[Skeleton, dict]:
    """Drop the pieces of a skeleton that the photos refute.

    Parameters
    ----------
    skeleton : Skeleton
    workspace : MetricWorkspace
        The undistorted photos, in its frame.
    masks : SkyMasks
        Of the same photos.
    least_photos : int
        As in `DropOptions`.

    Returns
    -------
    skeleton : Skeleton
        What is left.
    report : dict
        ``length``, ``judged_length`` and ``refuted_length`` before, ``dropped_length``, and
        ``pieces``, the longest first: ``length``, ``refuted_length``, ``n_photos`` that show clear
        sky (the median of the refuted places), and ``edges``, each lower end, upper end, radius.
    """
    poses = workspace.poses
    places = places_along(skeleton, step_of(skeleton, poses))
    votes = Votes(*np.zeros((2, len(poses), len(places.points)), dtype=bool))
    for i, _, shown in clear_skies(workspace, masks):
        votes.clear[i], votes.solid[i] = vote(shown, poses, i, places)
    is_refuted = stands_out(votes, places.radius, least_photos)
    is_kept = _kept(skeleton, places, is_refuted)
    pieces = _pieces(skeleton, places, is_refuted, votes.clear.sum(axis=0), is_kept)
    verdict = judge(votes, least_photos)
    judged, refuted = (
        float(places.length[rows].sum()) for rows in (verdict.is_judged, verdict.is_refuted)
    )
    dropped = sum(piece["length"] for piece in pieces)
    logger.info(
        "photos refute %.2f of %.2f %s of skeleton that they can judge; %d pieces of %.2f in all "
        "are dropped",
        refuted,
        judged,
        skeleton.unit,
        len(pieces),
        dropped,
    )
    return skeleton.select(is_kept), {
        "length": rounded(skeleton.edge_length.sum()),
        "judged_length": rounded(judged),
        "refuted_length": rounded(refuted),
        "dropped_length": rounded(dropped),
        "pieces": pieces,
    }


def _kept(skeleton: Skeleton, places: Places, is_refuted: np.ndarray) -> np.ndarray:
    """Which nodes stay: those of the subtree of which most is left over what is refuted."""
    n = len(skeleton)
    gain = np.bincount(places.node, np.where(is_refuted, -1.0, 1.0) * places.length, n)
    if gain.sum() < 0:
        logger.warning("photos refute most of the skeleton: nothing is dropped")
        return np.ones(n, dtype=bool)
    for node in range(n - 1, 0, -1):
        gain[skeleton.parent[node]] += max(gain[node], 0.0)
    is_kept = gain >= 0
    is_kept[0] = True
    for node in range(1, n):
        is_kept[node] &= is_kept[skeleton.parent[node]]
    return is_kept


def _pieces(
    skeleton: Skeleton,
    places: Places,
    is_refuted: np.ndarray,
    n_clear: np.ndarray,
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
        is_wrong = rows & is_refuted
        ends = skeleton.points[skeleton.parent[nodes]], skeleton.points[nodes]
        edges = np.column_stack([*ends, skeleton.radius[nodes]])
        found.append(
            {
                "length": rounded(places.length[rows].sum()),
                "refuted_length": rounded(places.length[is_wrong].sum()),
                "n_photos": int(np.median(n_clear[is_wrong])),
                "edges": np.round(edges, 6).tolist(),
            }
        )
    return sorted(found, key=lambda each: -each["length"])
