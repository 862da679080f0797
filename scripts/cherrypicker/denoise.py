"""Removal of isolated points and of sky silhouettes (paper, section Denoising).

The paper's two filters, in its order, and one of ours between them. The statistical one removes
points far from their neighbours; ours those whose surroundings hardly any photo supports.
The sky filter removes points that bear a dominant sky colour: stereo windows reach over the border
of a thin branch and give its neighbourhood the branch's depth and the sky's colour. Colour alone
would also eat white paint, lichen and sunlit bark, so the photos decide (this is ours, not the
paper's): a point of sky colour goes only where most photos that see it show sky.

Most photos look past a thin branch at the ground and say nothing: their pixel is no sky, whether
the branch is there or not. They would outvote the few that look up, and hardly any silhouette would
go. So a photo that shows no sky at a point counts only where it could have shown some, with sky a
few pixels aside, or where its pixel has the point's own colour.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from cherrypicker.errors import StageError
from cherrypicker.pointcloud import PointCloud
from cherrypicker.poses import Poses
from cherrypicker.progress import Progress
from cherrypicker.sky.colors import SkyColors

logger = logging.getLogger(__name__)

#: Points per block of the neighbour search; bounds the memory, changes no result.
BLOCK = 200_000
#: Longer side of the depth buffers that decide which photos see a point, pixels.
BUFFER_SIDE = 500
#: A point is seen when it lies at most this share of its depth behind the nearest surface.
DEPTH_TOLERANCE = 0.01
#: A photo could show sky at a pixel when it has sky this near, a share of its longer side.
SKY_REACH = 0.005


@dataclass(frozen=True)
class DenoiseOptions:
    """Settings of `denoise_cloud`; the fields are the config keys of ``denoise``."""

    use_statistical: bool = True
    n_neighbors: int = 20
    std_ratio: float = 3.0
    min_view_ratio: float = 0.33
    use_sky: bool = True
    sky_color_distance: float = 0.1
    same_color_distance: float = 0.15
    min_non_sky_fraction: float = 0.5


@dataclass(frozen=True)
class SkyEvidence:
    """How the photos see some points.

    Attributes
    ----------
    n_sky : ndarray of shape (n,), int32
        Photos that show sky where the point should be, nothing of the cloud before it.
    n_non_sky : ndarray of shape (n,), int32
        Photos that show something else there, though sky is near or the colour the point's.
    """

    n_sky: np.ndarray
    n_non_sky: np.ndarray


def neighbor_means(
    points: np.ndarray, values: np.ndarray, n_neighbors: int
) -> tuple[np.ndarray, np.ndarray]:
    """Average over the ``n_neighbors`` nearest points, the point itself counted as one.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    values : ndarray of shape (n_points,)
    n_neighbors : int

    Returns
    -------
    mean_distance : ndarray of shape (n_points,), float64
        Mean distance, the point's own zero included.
    mean_value : ndarray of shape (n_points,), float64
    """
    n_points = len(points)
    k = min(n_neighbors, n_points)
    tree = cKDTree(points)
    mean_distance, mean_value = np.empty(n_points), np.empty(n_points)
    for start in range(0, n_points, BLOCK):
        block = slice(start, start + BLOCK)
        distances, index = tree.query(points[block], k=[*range(1, k + 1)], workers=-1)
        mean_distance[block] = distances.mean(axis=1)
        mean_value[block] = values[index].mean(axis=1)
    return mean_distance, mean_value


def statistical_inliers(mean_distance: np.ndarray, std_ratio: float) -> np.ndarray:
    """Find the points whose neighbours are about as near as elsewhere in the cloud.

    The mean distance must be below mean + std_ratio * standard deviation over the cloud: the maths
    of Open3D's ``remove_statistical_outlier``, which the paper uses.

    Parameters
    ----------
    mean_distance : ndarray of shape (n_points,), float64
        From `neighbor_means`.
    std_ratio : float

    Returns
    -------
    ndarray of shape (n_points,), bool
    """
    valid = mean_distance > 0  # Open3D leaves points out that coincide with all their neighbours
    if len(mean_distance) < 2 or not valid.any():
        return np.ones(len(mean_distance), bool)
    limit = mean_distance[valid].mean() + std_ratio * mean_distance[valid].std(ddof=1)
    return mean_distance < limit


def supported_points(n_views: np.ndarray, mean_views: np.ndarray, min_ratio: float) -> np.ndarray:
    """Find the points whose neighbourhood was seen by about as many photos as the rest.

    Two neighbouring photos can agree on a wrong match (a line of trees behind the crown, sliding
    along itself), a dozen cannot; a thin twig that few photos resolve still has better seen
    neighbours. Not in the paper.

    Parameters
    ----------
    n_views : ndarray of shape (n_points,)
        Photos that each point was fused from.
    mean_views : ndarray of shape (n_points,), float64
        Their mean over the point's neighbours, from `neighbor_means`.
    min_ratio : float
        Least ratio of ``mean_views`` to the cloud's median of ``n_views``.

    Returns
    -------
    ndarray of shape (n_points,), bool
    """
    return mean_views >= min_ratio * np.median(n_views)


@njit(cache=True, nogil=True)
def _depth_buffer(points, pose, K, scale, buffer):
    """Enter the depth of every point in front of a pinhole camera; the nearest one stays."""
    height, width = buffer.shape
    for row in range(len(points)):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if depth <= 0.0:
            continue
        across = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        down = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        u = math.floor((K[0, 0] * across / depth + K[0, 2]) * scale)
        v = math.floor((K[1, 1] * down / depth + K[1, 2]) * scale)
        if 0 <= u < width and 0 <= v < height and depth < buffer[v, u]:
            buffer[v, u] = depth


def _visible(poses: Poses, i: int, points: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Which of ``candidates`` photo ``i`` sees: in the frame and not behind another point."""
    uv, depth = poses.project(points[candidates], i)
    width, height = int(poses.width[i]), int(poses.height[i])
    with np.errstate(invalid="ignore"):
        inside = (depth > 0) & (uv >= 0).all(axis=1) & (uv[:, 0] < width) & (uv[:, 1] < height)
    if not inside.any():
        return inside
    scale = min(1.0, BUFFER_SIDE / max(width, height))
    buffer = np.full((int(height * scale) + 1, int(width * scale) + 1), np.inf)
    _depth_buffer(points, poses.cam_from_world[i], poses.K[i], scale, buffer)
    column, line = (uv[inside] * scale).astype(np.int64).T
    inside[inside] = depth[inside] <= buffer[line, column] * (1 + DEPTH_TOLERANCE)
    return inside


def _near_sky(sky: np.ndarray) -> np.ndarray:
    """Grow a sky mask by `SKY_REACH`."""
    reach = max(1, round(SKY_REACH * max(sky.shape)))
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return cv2.dilate(sky.astype(np.uint8), kernel) > 0


def sky_evidence(
    cloud: PointCloud,
    candidates: np.ndarray,
    poses: Poses,
    to_photo: Callable[[int, np.ndarray], np.ndarray],
    look: Callable[[int], tuple[np.ndarray, np.ndarray]],
    same_color_distance: float,
) -> SkyEvidence:
    """Ask all photos about some points of a cloud.

    Parameters
    ----------
    cloud : PointCloud
        With colours; all of it, since its points hide each other.
    candidates : ndarray of shape (n,), int
        Rows of the points asked about.
    poses : Poses
        In the cloud's frame; undistorted pinhole.
    to_photo : callable
        ``to_photo(i, in_camera)`` projects camera coordinates (m, 3) to the pixels (m, 2) of the
        photo as stored, lens distortion included.
    look : callable
        ``look(i)`` returns the photo, (H, W, 3) uint8, and its sky mask, (H, W) bool.
    same_color_distance : float
        A pixel whose colour is this near to the point's shows the point.
    """
    n_sky = np.zeros(len(candidates), np.int32)
    n_non_sky = np.zeros(len(candidates), np.int32)
    with Progress(len(poses), "photos asked about sky silhouettes") as bar:
        for i in range(len(poses)):
            rows = np.flatnonzero(_visible(poses, i, cloud.points, candidates))
            if len(rows):
                image, sky = look(i)
                at = cloud.points[candidates[rows]]
                in_camera = at @ poses.rotations[i].T + poses.cam_from_world[i, :, 3]
                uv = to_photo(i, in_camera)
                with np.errstate(invalid="ignore"):
                    inside = (uv >= 0).all(axis=1) & (uv < sky.shape[::-1]).all(axis=1)
                rows = rows[inside]
                column, line = uv[inside].astype(np.int64).T
                is_sky = sky[line, column]
                offset = image[line, column] / 255.0 - cloud.colors[candidates[rows]]
                alike = np.linalg.norm(offset, axis=1) <= same_color_distance
                n_sky[rows] += is_sky
                n_non_sky[rows] += ~is_sky & (alike | _near_sky(sky)[line, column])
            bar.step()
    return SkyEvidence(n_sky, n_non_sky)


def _share(part: int, whole: int) -> str:
    return f"{part:,} of {whole:,} points ({100 * part / max(whole, 1):.1f} %)"


def denoise_cloud(
    cloud: PointCloud,
    sky: SkyColors,
    evidence_of: Callable[[PointCloud, np.ndarray], SkyEvidence],
    options: DenoiseOptions,
) -> tuple[PointCloud, dict]:
    """Remove isolated points, then sky silhouettes.

    Parameters
    ----------
    cloud : PointCloud
        With colours, else the sky filter is skipped.
    sky : SkyColors
        Dominant sky colours; without any the sky filter has nothing to do.
    evidence_of : callable
        ``evidence_of(cloud, candidates)`` returns a `SkyEvidence`, see `sky_evidence`.
    options : DenoiseOptions

    Returns
    -------
    cloud : PointCloud
    report : dict
        ``n_input``, ``n_removed_statistical``, ``n_removed_views``, ``n_sky_colored``,
        ``n_kept_by_photos``, ``n_removed_sky``, ``n_output``.

    Raises
    ------
    StageError
        When no point is left.
    """
    report = {"n_input": len(cloud), "n_sky_colored": 0, "n_kept_by_photos": 0, "n_removed_sky": 0}
    cloud, counts = _remove_isolated(cloud, options)
    report |= counts
    if options.use_sky:
        cloud, counts = _remove_sky(cloud, sky, evidence_of, options)
        report |= counts
    report["n_output"] = len(cloud)
    logger.info("denoising kept %s", _share(len(cloud), report["n_input"]))
    return cloud, report


def _remove_isolated(cloud, options) -> tuple[PointCloud, dict]:
    """Drop what is far from its neighbours, and what hardly any photo supports."""
    n_views = cloud.fields.get("n_views") if options.min_view_ratio > 0 else None
    counts = {"n_removed_statistical": 0, "n_removed_views": 0}
    if n_views is None and not options.use_statistical:
        return cloud, counts
    values = np.zeros(len(cloud)) if n_views is None else n_views
    mean_distance, mean_views = neighbor_means(cloud.points, values, options.n_neighbors)
    keep = np.ones(len(cloud), bool)
    if options.use_statistical:
        keep = statistical_inliers(mean_distance, options.std_ratio)
        counts["n_removed_statistical"] = int(np.count_nonzero(~keep))
        logger.info(
            "statistical filter: removed %s", _share(counts["n_removed_statistical"], len(cloud))
        )
    if n_views is not None:
        is_supported = supported_points(n_views, mean_views, options.min_view_ratio)
        counts["n_removed_views"] = int(np.count_nonzero(keep & ~is_supported))
        logger.info(
            "seen by too few photos: removed %s", _share(counts["n_removed_views"], len(cloud))
        )
        keep &= is_supported
    if not keep.any():
        raise StageError(
            f"the statistical filter removed all {len(cloud):,} points",
            key="denoise.std_ratio, denoise.min_view_ratio",
        )
    return cloud.select(keep), counts


def _remove_sky(cloud, sky, evidence_of, options) -> tuple[PointCloud, dict]:
    if sky.n_clusters == 0:
        logger.info("sky filter: no sky in the photos, nothing to do")
        return cloud, {}
    if cloud.colors is None:
        logger.warning("sky filter skipped: the cloud has no colours")
        return cloud, {}
    candidates = np.flatnonzero(sky.distance(cloud.colors) <= options.sky_color_distance)
    logger.info("sky filter: %s have a sky colour", _share(len(candidates), len(cloud)))
    if len(candidates) == 0:
        return cloud, {}
    evidence = evidence_of(cloud, candidates)
    n_seen = evidence.n_sky + evidence.n_non_sky
    # A point that no photo sees has nothing but its colour against it, and stays.
    share = evidence.n_non_sky / np.maximum(n_seen, 1)
    spared = (n_seen == 0) | (share >= options.min_non_sky_fraction)
    removed = candidates[~spared]
    counts = {
        "n_sky_colored": len(candidates),
        "n_kept_by_photos": int(np.count_nonzero(spared)),
        "n_removed_sky": len(removed),
    }
    logger.info(
        "sky filter: removed %s, the photos spared %s",
        _share(len(removed), len(cloud)),
        _share(counts["n_kept_by_photos"], len(candidates)),
    )
    if len(removed) == len(cloud):
        raise StageError(
            f"the sky filter removed all {len(cloud):,} points",
            key="denoise.min_non_sky_fraction, denoise.sky_color_distance",
        )
    keep = np.ones(len(cloud), bool)
    keep[removed] = False
    return cloud.select(keep), counts
