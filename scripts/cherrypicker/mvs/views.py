"""Which photos help to measure the depth of which, and how deep a photo can see.

What a scan is about is the region of interest, the place that its cameras look at: sources are
chosen to cover the part of it that a photo frames, and the depth range begins before it. The sparse
points will not do for that: they lie on grass, hedges and hills, and a crown has next to none. They
decide alone where the cameras look at no common place.
"""

import logging
from dataclasses import dataclass

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.mvs.workspace import Workspace
from cherrypicker.placement.region import framing
from cherrypicker.poses import View

logger = logging.getLogger(__name__)

# Best angle between two rays: below it depth is ill conditioned, above it bark and twigs look
# different (and hide one another); the spread is wide above, since rings of photos may be sparse.
# After MVSNet (Yao et al., ECCV 2018): 5, 1 and 10 degrees there
BEST_ANGLE_DEG = 11.0
SPREAD_BELOW_DEG = 5.0
SPREAD_ABOVE_DEG = 13.0
# A place is covered when its sources' weights (1 for the best angle and an equal scale) add up to
# this (guess)
COVER = 2.0
# A source that adds less, as a share of all that could be covered, is not worth its time (guess)
LEAST_GAIN = 0.002
# Per cent of the sparse points' depths from which the depth range begins, and how much nearer: they
# are corners of bark and grass, twigs may be nearer (guess)
DEPTH_PERCENTILE = 0.5
NEARER = 0.7


@dataclass(frozen=True)
class StereoProblem:
    """One reference view, its sources and its depth range."""

    view: int  # index of the reference in ``workspace.views``
    sources: tuple[int, ...]  # indices of the source views, best first
    # depth_min, depth_max: depth range along the optical axis, units of the model, up to where a
    # middling source sees one pixel of parallax
    depth_min: float
    depth_max: float
    # (n_points, 2) float32: where the sparse points that the view observes lie, px, pixel centres
    # at 0.5
    sparse_uv: np.ndarray
    sparse_depth: np.ndarray  # (n_points,) float32: their depths

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
    # (n_views, n) bool: whether a view shows a place: frames it, or matched a sparse point there
    shown: np.ndarray


def plan_views(
    workspace: Workspace, n_sources: int, *, cover: float = COVER
) -> list[StereoProblem]:
    """Choose sources and depth range of every view.

    Sources are taken one by one, each time the one that adds most to the sum over the places in
    the reference's frame of ``worth * min(cover, weights so far)``. A source's weight at a place is
    that of the angle between the rays (best at 11 degrees) times that of the scale.

    A reference gets ``n_sources`` at most, fewer where all places are covered: where the sum of
    weights is ``cover``. Views that see no sparse points are left out and named in the log.

    Raises
    ------
    StageError
        If no view can be matched.
    """
    views = workspace.views
    sparse, seen = _observations(workspace)
    framed = workspace.poses.frames(sparse)
    region = workspace.region
    if region is not None:
        shown = framing(workspace.poses, region)
        places = Places(region.samples, shown.mean(axis=0), shown)
    else:
        places = Places(sparse, np.ones(len(sparse)), seen)
    problems = []
    for i, view in enumerate(views):
        own = np.flatnonzero(seen[i])
        if len(own) == 0:
            logger.warning("%s: no sparse points, no depth map", view.name)
            continue
        sources = choose_sources(views, i, places, n_sources, cover)
        if not sources:
            logger.warning("%s: no other photo sees what it shows, no depth map", view.name)
            continue
        uv, depth = view.project(sparse[own])
        # Of its own points, and of those that its sources see in its frame
        near = view.project(sparse[seen[list(sources)].any(axis=0) & framed[i]])[1]
        all_depths = np.concatenate([depth, near])
        low = min(np.percentile(each, DEPTH_PERCENTILE) for each in (depth, all_depths))
        depth_min = NEARER * low
        if region is not None:
            through = view.project(region.samples[shown[i]])[1]
            depth_min = min(depth_min, through.min())
        # Up to one pixel of parallax: hills that no depth fits would take that of the crown
        baselines = [np.linalg.norm(views[j].center - view.center) for j in sources]
        depth_max = view.K[0, 0] * np.median(baselines)
        if depth_max <= depth_min:
            logger.warning("%s: its sources see no parallax, no depth map", view.name)
            continue
        sparse_at = uv.astype(np.float32), depth.astype(np.float32)
        problems.append(StereoProblem(i, sources, float(depth_min), float(depth_max), *sparse_at))
    if not problems:
        raise StageError(
            f"none of {len(views)} photos shares sparse points with another",
            file=workspace.folder / "sparse",
            key="sfm.min_registered_fraction",
        )
    n = np.mean([len(problem.sources) for problem in problems])
    logger.info(f"{len(problems)} of {len(views)} photos get a depth map, {n:.1f} sources each")
    return problems


def _observations(workspace: Workspace) -> tuple[np.ndarray, np.ndarray]:
    """Return the sparse points (n, 3) and which view observes which, (n_views, n) bool."""
    ids = np.array(sorted(workspace.model.points3D), dtype=np.int64)
    points = np.array([workspace.model.points3D[int(i)].xyz for i in ids]).reshape(-1, 3)
    seen = np.zeros((len(workspace.views), len(ids)), dtype=bool)
    images = {image.name: image for image in workspace.model.images.values()}
    for row, view in enumerate(workspace.views):
        observed = [p.point3D_id for p in images[view.name].points2D if p.has_point3D()]
        seen[row, np.searchsorted(ids, np.array(observed, dtype=np.int64))] = True
        seen[row] &= view.project(points)[1] > 0.0
    return points, seen


def choose_sources(
    views: list[View], i: int, places: Places, n_sources: int, cover: float
) -> tuple[int, ...]:
    """Cover what view ``i`` shows with at most ``n_sources`` other views, the most useful first."""
    own = np.flatnonzero(places.shown[i])
    worth = places.worth[own]
    # Weight of every view as a source of this one at the places, (n_views, n), between 0 and 1
    rays = np.array([view.center for view in views])[:, None] - places.points[own]
    distance = np.linalg.norm(rays, axis=2)
    cosine = np.einsum("vni,ni->vn", rays, rays[i]) / (distance * distance[i])
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    spread = np.where(angle < BEST_ANGLE_DEG, SPREAD_BELOW_DEG, SPREAD_ABOVE_DEG)
    pixel_size = distance / np.array([[view.K[0, 0]] for view in views])
    ratio = pixel_size / pixel_size[i]
    likeness = np.minimum(ratio, 1.0 / ratio) ** 2
    weights = np.exp(-0.5 * ((angle - BEST_ANGLE_DEG) / spread) ** 2) * likeness
    weights = weights * places.shown[:, own]
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
