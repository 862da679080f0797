"""Which photos help to measure the depth of which, and how deep a photo can see.

What a scan is about is the region of interest, the place that its cameras look at: sources are
chosen to cover the part of it that a photo frames, and the depth range reaches through it. The
sparse points will not do for that: they lie on grass, hedges and hills, and a crown has next to
none. They decide alone where the cameras look at no common place.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.mvs.workspace import View, Workspace
from cherrypicker.placement.region import Region, framing

logger = logging.getLogger(__name__)

# Best angle between two rays: below it depth is ill conditioned, above it bark and twigs look
# different (and hide one another); the spread is wide above, since rings of photos may be sparse.
# After MVSNet (Yao et al., ECCV 2018): 5, 1 and 10 degrees there
BEST_ANGLE_DEG = 11.0
SPREAD_BELOW_DEG = 5.0
SPREAD_ABOVE_DEG = 13.0
# What a sparse point counts that falls into a photo's frame without being matched there (guess)
UNMATCHED_WEIGHT = 0.15
# Sparse points without which a photo has no depth range (guess)
MIN_POINTS = 8
# A place is covered when its sources' weights (1 for the best angle and an equal scale) add up to
# this (guess)
COVER = 2.0
# A source that adds less, as a share of all that could be covered, is not worth its time (guess)
LEAST_GAIN = 0.002
# Percentiles of the sparse points' depths that bound the depth range, and how far it is widened to
# the front and to the back: they are corners of bark and grass, twigs may be nearer and background
# farther (guess)
DEPTH_PERCENTILES = (0.5, 99.5)
NEARER, FARTHER = 0.7, 1.6


@dataclass(frozen=True)
class StereoProblem:
    """One reference view, its sources and its depth range."""

    view: int  # index of the reference in ``workspace.views``
    sources: tuple[int, ...]  # indices of the source views, best first
    # depth_min, depth_max: depth range along the optical axis, units of the model
    depth_min: float
    depth_max: float
    # (n_points, 2) float32: where the sparse points that the view observes lie, px, pixel centres
    # at 0.5
    sparse_uv: np.ndarray
    sparse_depth: np.ndarray  # (n_points,) float32: their depths
    # The scan's region of interest, None where its cameras look at no common place
    region: Region | None = None

    @property
    def photos(self) -> tuple[int, ...]:
        """Reference and sources."""
        return self.view, *self.sources


@dataclass(frozen=True)
class Places:
    """What sources are to cover: samples of the region, or the sparse points."""

    points: np.ndarray  # (n, 3)
    # (n,): what covering a place is worth: for the region the share of the photos that frame it
    worth: np.ndarray
    # (n_views, n) float32: what a view shows of a place: 0 outside its frame, else 1, or less where
    # that is unsure
    shown: np.ndarray
    own: np.ndarray  # (n_views, n) bool: the places that a view is to measure


def plan_views(
    workspace: Workspace, n_sources: int, *, cover: float = COVER
) -> list[StereoProblem]:
    """Choose sources and depth range of every view.

    Sources are taken one by one, each time the one that adds most to the sum over the places in
    the reference's frame of ``worth * min(cover, weights so far)``. A source's weight at a place is
    that of the angle between the rays (best at 11 degrees) times that of the scale.

    Parameters
    ----------
    n_sources : int
        Most sources per reference; fewer where the places are covered.
    cover : float
        Sum of weights at which a place counts as covered.

    Returns
    -------
    list of StereoProblem
        Views that see too few sparse points are left out and named in the log.

    Raises
    ------
    StageError
        If no view can be matched.
    """
    views = workspace.views
    sparse, seen = _observations(workspace)
    region = workspace.region
    places = _sparse_places(views, sparse, seen)
    if region is not None:
        places = _region_places(workspace, region)
    problems = []
    for i, view in enumerate(views):
        own = np.flatnonzero(seen[i])
        if len(own) < MIN_POINTS:
            logger.warning("%s: only %d sparse points, no depth map", view.name, len(own))
            continue
        sources = choose_sources(views, i, places, n_sources, cover)
        if not sources:
            logger.warning("%s: no other photo sees what it shows, no depth map", view.name)
            continue
        uv, depth = view.project(sparse[own])
        near = _depths_in_frame(view, sparse[seen[list(sources)].any(axis=0)])
        depth_min, depth_max = _depth_range(depth, near)
        if region is not None:
            through = view.project(region.samples[places.own[i]])[1]
            depth_min = min(depth_min, float(through.min()))
            depth_max = max(depth_max, float(through.max()))
        problems.append(
            StereoProblem(
                view=i,
                sources=sources,
                depth_min=depth_min,
                depth_max=depth_max,
                sparse_uv=uv.astype(np.float32),
                sparse_depth=depth.astype(np.float32),
                region=region,
            )
        )
    if not problems:
        raise StageError(
            f"none of {len(views)} photos shares {MIN_POINTS} sparse points with another",
            file=workspace.folder / "sparse",
            key="sfm.min_registered_fraction",
        )
    logger.info(
        "%d of %d photos get a depth map, %.1f sources each",
        len(problems),
        len(views),
        np.mean([len(problem.sources) for problem in problems]),
    )
    return problems


def _observations(workspace: Workspace) -> tuple[np.ndarray, np.ndarray]:
    """Return the sparse points (n, 3) and which view observes which, (n_views, n) bool."""
    ids = np.array(sorted(workspace.model.points3D), dtype=np.int64)
    points = np.array([workspace.model.points3D[int(i)].xyz for i in ids]).reshape(-1, 3)
    seen = np.zeros((len(workspace.views), len(ids)), dtype=bool)
    for row, view in enumerate(workspace.views):
        points2D = workspace.image(view).points2D
        observed = [point.point3D_id for point in points2D if point.has_point3D()]
        seen[row, np.searchsorted(ids, np.array(observed, dtype=np.int64))] = True
        seen[row] &= view.project(points)[1] > 0.0
    return points, seen


def _sparse_places(views: list[View], points: np.ndarray, seen: np.ndarray) -> Places:
    """Take all that the photos share as the places to cover."""
    shown = np.stack([_in_frame(view, *view.project(points)) for view in views])
    shown = np.where(seen, 1.0, UNMATCHED_WEIGHT * shown).astype(np.float32)
    return Places(points, np.ones(len(points)), shown, seen)


def _region_places(workspace: Workspace, region: Region) -> Places:
    """Take the region of interest as the places to cover, by how many photos frame each."""
    framed = framing(workspace.poses, region)
    return Places(region.samples, framed.mean(axis=0), framed.astype(np.float32), framed)


def _in_frame(view: View, uv: np.ndarray, depth: np.ndarray) -> np.ndarray:
    inside = (uv >= 0.0).all(axis=1) & (uv[:, 0] < view.width) & (uv[:, 1] < view.height)
    return inside & (depth > 0.0)


def _depths_in_frame(view: View, points: np.ndarray) -> np.ndarray:
    uv, depth = view.project(points)
    return depth[_in_frame(view, uv, depth)]


def choose_sources(
    views: list[View], i: int, places: Places, n_sources: int, cover: float
) -> tuple[int, ...]:
    """Cover what view ``i`` shows with at most ``n_sources`` other views, the most useful first."""
    own = np.flatnonzero(places.own[i])
    worth = places.worth[own]
    weights = _weights(views, i, places.points[own]) * places.shown[:, own]
    weights[i] = 0.0
    covered = np.zeros(len(own))
    sources: list[int] = []
    least = LEAST_GAIN * cover * worth.sum()
    while len(sources) < min(n_sources, len(views) - 1):
        gains = (np.minimum(cover, covered + weights) - covered) @ worth
        best = int(np.argmax(gains))
        if gains[best] <= least:
            break
        sources.append(best)
        covered = np.minimum(cover, covered + weights[best])
        weights[best] = 0.0
    return tuple(sources)


def _weights(views: list[View], i: int, points: np.ndarray) -> np.ndarray:
    """Weight of every view as a source of view ``i`` at points (n, 3), (n_views, n) in [0, 1]."""
    to_reference = views[i].center - points
    distance = np.linalg.norm(to_reference, axis=1)
    pixel_size = distance / views[i].K[0, 0]
    weights = np.zeros((len(views), len(points)))
    for j, other in enumerate(views):
        if j == i:
            continue
        to_other = other.center - points
        other_distance = np.linalg.norm(to_other, axis=1)
        cosine = np.einsum("ij,ij->i", to_reference, to_other) / (distance * other_distance)
        angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        spread = np.where(angle < BEST_ANGLE_DEG, SPREAD_BELOW_DEG, SPREAD_ABOVE_DEG)
        ratio = other_distance / other.K[0, 0] / pixel_size
        weights[j] = np.exp(-0.5 * ((angle - BEST_ANGLE_DEG) / spread) ** 2)
        weights[j] *= np.minimum(ratio, 1.0 / ratio) ** 2
    return weights


def _depth_range(own: np.ndarray, near: np.ndarray) -> tuple[float, float]:
    """Depth range from the view's own points and those its sources see in its frame."""
    low, high = np.percentile(np.concatenate([own, near]), DEPTH_PERCENTILES)
    low = min(low, np.percentile(own, DEPTH_PERCENTILES[0]))
    return NEARER * float(low), FARTHER * float(high)
