"""The photos judge a skeleton: what of it is not there, what is missing, how thick it is."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label, wood_mask
from cherrypicker.files import rounded
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.lines.lines import gather_lines
from cherrypicker.photo_check.missing import Missing, find_missing
from cherrypicker.photo_check.pictures import draw_verdict
from cherrypicker.photo_check.pieces import pieces_of
from cherrypicker.photo_check.places import MetricWorkspace, Places, places_along, step_of
from cherrypicker.photo_check.votes import Verdict, Votes, clear_skies, judge, vote
from cherrypicker.photo_check.widths import branch_diameters, silhouette_widths
from cherrypicker.placement.region import Region
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton.model import Skeleton

__all__ = ["CheckOptions", "check_photos"]

logger = logging.getLogger(__name__)

# Classes of radius in the report, m: twigs, thin and thick limbs
RADII_M = (0.0, 0.003, 0.006, 0.012, np.inf)
# Radius of the ball in which missing wood is looked for, in that of the ball around the skeleton's
# box (guess: a third of the height may be cut off)
AROUND = 1.3
# A photo that shows less before the sky than this share of what half of them show is no example
TELLING = 0.5
# A place is not in the cloud where no wood point lies within so many steps of it
IN_CLOUD_STEPS = 2.0
# Layers of the tree's height in which missing wood is counted
N_LAYERS = 10


@dataclass(frozen=True)
class CheckOptions:
    """When photos refute; the fields are the config keys of ``photo_check``.

    Attributes
    ----------
    least_photos : int
        Photos that must say something about a place, and that must show clear sky to refute it.
    """

    least_photos: int = 2


def check_photos(
    skeleton: Skeleton,
    cloud: PointCloud,
    workspace: MetricWorkspace,
    masks: SkyMasks,
    options: CheckOptions,
    *,
    other_stems: np.ndarray,
    refuted: dict | None = None,
    threads: int = 1,
) -> tuple[dict, dict[str, np.ndarray]]:
    """Let the photos judge a skeleton.

    Parameters
    ----------
    skeleton : Skeleton
    cloud : PointCloud
        The labelled cloud in the skeleton's frame.
    workspace : MetricWorkspace
        The undistorted photos, in that frame.
    masks : SkyMasks
        Of the same photos.
    options : CheckOptions
    other_stems : ndarray of shape (n, 2)
        Feet of other trees; what stands nearer to them than to the skeleton's root is theirs.
    refuted : dict, optional
        What `drop_refuted` dropped of it before.
    threads : int

    Returns
    -------
    report : dict
        Content of ``photo_check.json``.
    pictures : dict of str to ndarray of shape (height, width, 3), uint8
        ``worst`` and ``best``.
    """
    poses, region = workspace.poses, _around(skeleton)
    step = step_of(skeleton, poses)
    places = places_along(skeleton, step)
    votes, width, pixel = _look(workspace, masks, places)
    verdict = judge(votes, options.least_photos)
    others = _not_this_tree(cloud, skeleton, other_stems)
    lines = gather_lines(workspace, masks)
    missing = find_missing(workspace, lines, places, region, others, threads)
    report = _report(skeleton, places, verdict, missing)
    wrong = verdict.is_refuted
    report["refuted_pieces"] = pieces_of(places.points[wrong], places.length[wrong], step)
    wood = cKDTree(cloud.points[wood_mask(cloud["label"])])
    is_lost = wood.query(missing.points)[0] > IN_CLOUD_STEPS * step
    report["missing_from_cloud_length"] = rounded(missing.length[is_lost].sum())
    report["before"], dropped = _before(refuted)
    report["missing_pieces"] = pieces_of(missing.points, missing.length, step)
    scores = _scores(places, votes, verdict, missing)
    report["photos"] = [
        {"name": name, "share_right": None if np.isnan(score) else rounded(score)}
        for name, score in zip(poses.names.tolist(), scores, strict=True)
    ]
    report["branches"] = branch_diameters(skeleton, places, width, pixel)
    logger.info(
        "photos refute %.2f of %.2f %s of skeleton that they can judge (precision %.3f), and show "
        "%.2f of thin wood that it lacks (recall %.3f)",
        report["refuted_length"],
        report["judged_length"],
        skeleton.unit,
        np.nan if report["photo_precision"] is None else report["photo_precision"],
        report["missing_length"],
        np.nan if report["photo_recall"] is None else report["photo_recall"],
    )
    pictures = {
        name: draw_verdict(workspace, int(row), places, *verdict, missing.points, dropped)
        for name, row in (
            ("worst", np.argmin(np.nan_to_num(scores, nan=np.inf))),
            ("best", np.argmax(np.nan_to_num(scores, nan=-np.inf))),
        )
    }
    return report, pictures


def _look(
    workspace: MetricWorkspace, masks: SkyMasks, places: Places
) -> tuple[Votes, np.ndarray, np.ndarray]:
    """Votes and widths, see `silhouette_widths`, of all photos."""
    poses, n_places = workspace.poses, len(places.points)
    votes = Votes(*np.zeros((2, len(poses), n_places), dtype=bool))
    width, pixel = np.empty((2, len(poses), n_places), dtype=np.float32)
    for i, photo, shown in clear_skies(workspace, masks):
        votes.clear[i], votes.solid[i] = vote(shown, poses, i, places)
        width[i], pixel[i] = silhouette_widths(photo, shown, poses, i, places)
    return votes, width, pixel


def _around(skeleton: Skeleton) -> Region:
    """A ball around a skeleton in which its missing wood is looked for."""
    low, high = skeleton.points.min(axis=0), skeleton.points.max(axis=0)
    radius = AROUND * float(np.linalg.norm(high - low)) / 2
    return Region((low + high) / 2, radius, radius, np.empty((0, 3)))


def _not_this_tree(cloud: PointCloud, skeleton: Skeleton, other_stems: np.ndarray) -> np.ndarray:
    """Points of signs, posts, other trees and the like, (n, 3)."""
    label = cloud["label"]
    is_wood = wood_mask(label)
    is_other = ~is_wood & (label != Label.GROUND) & (label != Label.UNLABELLED)
    if len(other_stems):
        stems = np.vstack([skeleton.points[:1, :2], other_stems])
        apart = np.linalg.norm(cloud.points[:, None, :2] - stems[None], axis=2)
        is_other |= is_wood & (apart.argmin(axis=1) > 0)
    return cloud.points[is_other]


def _report(skeleton: Skeleton, places: Places, verdict: Verdict, missing: Missing) -> dict:
    """The numbers of ``photo_check.json`` but those of single photos and branches."""
    length = places.length
    judged, refuted = (float(length[m].sum()) for m in (verdict.is_judged, verdict.is_refuted))
    right, lacking = judged - refuted, float(missing.length.sum())
    report: dict[str, Any] = {
        "unit": skeleton.unit,
        "photo_precision": _share(right, judged),
        "photo_recall": _share(right, right + lacking),
        "photo_confirmed": _share(right, float(length.sum()) + lacking),
        "n_photos": len(missing.shown),
        "photo_sky_share": rounded(judged / length.sum()),
        "length": rounded(length.sum()),
        "judged_length": rounded(judged),
        "refuted_length": rounded(refuted),
        "missing_length": rounded(lacking),
    }
    rank = np.searchsorted(RADII_M, places.radius, side="right") - 1
    names = [f"{1e3 * low:g}-{1e3 * high:g}" for low, high in zip(RADII_M, RADII_M[1:])]
    report["by_order"] = _groups(places, verdict, places.order, range(places.order.max() + 1))
    report["by_radius_mm"] = dict(
        zip(names, _groups(places, verdict, rank, range(len(names))).values(), strict=True)
    )
    low, high = float(skeleton.points[:, 2].min()), float(skeleton.points[:, 2].max())
    report["missing_by_height"] = _layers(missing, low, high)
    return report


def _before(refuted: dict | None) -> tuple[dict | None, np.ndarray]:
    """What was dropped: numbers, and the edges as drawn, lower end, upper end, radius, (n, 7)."""
    if refuted is None:
        return None, np.empty((0, 7))
    judged = refuted["judged_length"]
    edges = [np.array(piece["edges"]) for piece in refuted["pieces"]]
    pieces = [
        {name: value for name, value in piece.items() if name != "edges"}
        | {"at": [rounded(value) for value in np.median(edge[:, 3:6], axis=0)]}
        for piece, edge in zip(refuted["pieces"], edges, strict=True)
    ]
    return {
        "photo_precision": _share(judged - refuted["refuted_length"], judged),
        "length": refuted["length"],
        "dropped_length": refuted["dropped_length"],
        "dropped_pieces": pieces,
    }, np.concatenate([np.empty((0, 7)), *edges])


def _groups(places: Places, verdict: Verdict, group: np.ndarray, ids: range) -> dict[str, dict]:
    """Length, and what of it is judged and refuted, for each group of places."""
    found = {}
    for one in ids:
        length = np.where(group == one, places.length, 0.0)
        found[str(one)] = {
            "length": rounded(length.sum()),
            "judged": rounded(length[verdict.is_judged].sum()),
            "refuted": rounded(length[verdict.is_refuted].sum()),
        }
    return found


def _layers(missing: Missing, low: float, high: float) -> list[dict]:
    """Length of missing wood in layers of the tree's height, the lowest and highest open."""
    edges = np.linspace(low, high, N_LAYERS + 1)
    layer = np.searchsorted(edges[1:-1], missing.points[:, 2], side="right")
    length = np.bincount(layer, missing.length, minlength=N_LAYERS)
    return [
        {"from": rounded(a), "to": rounded(b), "length": rounded(each)}
        for a, b, each in zip(edges[:-1], edges[1:], length, strict=True)
    ]


def _scores(places: Places, votes: Votes, verdict: Verdict, missing: Missing) -> np.ndarray:
    """Share of what each photo shows before the sky that the skeleton has right, (n_photos,).

    NaN where a photo shows little.
    """
    wrong = (votes.clear & verdict.is_refuted) @ places.length + missing.lacking
    right = (votes.solid & verdict.is_judged) @ places.length + missing.shown
    told = right + wrong
    tells = (told > 0) & (told >= TELLING * np.median(told))
    return np.where(tells, right / np.maximum(told, 1e-12), np.nan)


def _share(part: float, whole: float) -> float | None:
    return rounded(part / whole) if whole > 0 else None
