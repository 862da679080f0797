"""Which photos help to measure the depth of which, and how deep a photo can see.

Both come from the sparse model: shared points, the angle under which they are seen, the scale, and
the depths of a photo's own points.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.mvs.workspace import View, Workspace

logger = logging.getLogger(__name__)

# Best angle between two rays: below it depth is ill conditioned, above it bark and twigs look
# different (and hide one another); the spread is wide above, since rings of photos may be sparse
BEST_ANGLE_DEG = 11.0
SPREAD_BELOW_DEG = 5.0
SPREAD_ABOVE_DEG = 13.0
# What a point counts that falls into a photo's frame without being matched there
UNMATCHED_WEIGHT = 0.15
MIN_POINTS = 8


@dataclass(frozen=True)
class StereoProblem:
    """One reference view, its sources and its depth range.

    Attributes
    ----------
    view : int
        Index of the reference in ``workspace.views``.
    sources : tuple of int
        Indices of the source views, best first.
    depth_min, depth_max : float
        Depth range along the optical axis, units of the model.
    sparse_uv : ndarray of shape (n_points, 2), float32
        Where the sparse points that the view observes lie, px, pixel centres at 0.5.
    sparse_depth : ndarray of shape (n_points,), float32
        Their depths.
    """

    view: int
    sources: tuple[int, ...]
    depth_min: float
    depth_max: float
    sparse_uv: np.ndarray
    sparse_depth: np.ndarray


def plan_views(workspace: Workspace, n_sources: int) -> list[StereoProblem]:
    """Choose sources and depth range of every view.

    A source's score is the sum, over the sparse points in the reference, of an angle weight (best
    at 11 degrees between the rays) times a scale weight; points that the source frames without
    having matched them count 0.15.

    Parameters
    ----------
    workspace : Workspace
        The undistorted workspace.
    n_sources : int
        Most sources per reference.

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
    points, seen = _observations(workspace)
    problems = []
    for i, view in enumerate(views):
        own = np.flatnonzero(seen[i])
        if len(own) < MIN_POINTS:
            logger.warning("%s: only %d sparse points, no depth map", view.name, len(own))
            continue
        scores = _pair_scores(views, i, points[own], seen[:, own])
        order = np.argsort(-scores, kind="stable")
        sources = tuple(int(j) for j in order[:n_sources] if scores[j] > 0.0)
        if not sources:
            logger.warning("%s: no other photo sees its points, no depth map", view.name)
            continue
        uv, depth = _project(view, points[own])
        near = _depths_in_frame(view, points[seen[list(sources)].any(axis=0)])
        depth_min, depth_max = _depth_range(depth, near)
        problems.append(
            StereoProblem(
                view=i,
                sources=sources,
                depth_min=depth_min,
                depth_max=depth_max,
                sparse_uv=uv.astype(np.float32),
                sparse_depth=depth.astype(np.float32),
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
        image = workspace.model.images[view.image_id]
        observed = [p.point3D_id for p in image.points2D if p.has_point3D()]
        seen[row, np.searchsorted(ids, np.array(observed, dtype=np.int64))] = True
        seen[row] &= _project(view, points)[1] > 0.0
    return points, seen


def _project(view: View, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    in_camera = points @ view.R.T + view.t
    depth = in_camera[:, 2]
    safe = np.where(np.abs(depth) > 1e-12, depth, 1e-12)
    return (in_camera @ view.K.T)[:, :2] / safe[:, None], depth


def _in_frame(view: View, uv: np.ndarray, depth: np.ndarray) -> np.ndarray:
    inside = (uv >= 0.0).all(axis=1) & (uv[:, 0] < view.width) & (uv[:, 1] < view.height)
    return inside & (depth > 0.0)


def _depths_in_frame(view: View, points: np.ndarray) -> np.ndarray:
    uv, depth = _project(view, points)
    return depth[_in_frame(view, uv, depth)]


def _pair_scores(views: list[View], i: int, points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Score every view as a source of view ``i`` by its points (n, 3) seen (n_views, n)."""
    to_reference = views[i].center - points
    distance = np.linalg.norm(to_reference, axis=1)
    pixel_size = distance / views[i].K[0, 0]
    scores = np.zeros(len(views))
    for j, other in enumerate(views):
        if j == i:
            continue
        uv, depth = _project(other, points)
        to_other = other.center - points
        other_distance = np.linalg.norm(to_other, axis=1)
        cosine = np.einsum("ij,ij->i", to_reference, to_other) / (distance * other_distance)
        angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        spread = np.where(angle < BEST_ANGLE_DEG, SPREAD_BELOW_DEG, SPREAD_ABOVE_DEG)
        weight = np.exp(-0.5 * ((angle - BEST_ANGLE_DEG) / spread) ** 2)
        ratio = other_distance / other.K[0, 0] / pixel_size
        weight *= np.minimum(ratio, 1.0 / ratio) ** 2
        weight *= np.where(seen[j], 1.0, UNMATCHED_WEIGHT)
        scores[j] = weight[_in_frame(other, uv, depth)].sum()
    return np.where(scores > 1e-3 * len(points), scores, 0.0)


def _depth_range(own: np.ndarray, near: np.ndarray) -> tuple[float, float]:
    """Depth range from the view's own points and those its sources see in its frame.

    The points are corners of bark and grass; twigs may be nearer and background farther, so the
    range is widened by 30 % to the front and 60 % to the back.
    """
    depths = np.concatenate([own, near])
    low, high = np.percentile(depths, [0.5, 99.5])
    low = min(low, float(np.percentile(own, 0.5)))
    return 0.7 * float(low), 1.6 * float(high)
