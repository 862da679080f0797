"""Removal of isolated points and of sky silhouettes (paper, section Denoising).

Two filters, in the paper's order. The statistical one removes points far from their neighbours.
The sky filter removes points that bear a dominant sky colour: stereo windows reach over the border
of a thin branch and give its neighbourhood the branch's depth and the sky's colour. Colour alone
would also eat white paint, lichen and sunlit bark, so the photos decide (this is ours, not the
paper's): a point of sky colour goes only where most photos that see it show sky.

A photo that looks through a silhouette at the ground behind does not see the point: its pixel has
another colour. Such photos are not counted, else they would outvote the few that look up against
the sky, and hardly any silhouette would go.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
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


@dataclass(frozen=True)
class DenoiseOptions:
    """Settings of `denoise_cloud`; the fields are the config keys of ``denoise``."""

    use_statistical: bool = True
    n_neighbors: int = 20
    std_ratio: float = 3.0
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
        Photos that show something else there, of the point's colour.
    """

    n_sky: np.ndarray
    n_non_sky: np.ndarray


def statistical_inliers(points: np.ndarray, n_neighbors: int, std_ratio: float) -> np.ndarray:
    """Find the points whose neighbours are about as near as elsewhere in the cloud.

    The mean distance to the ``n_neighbors`` nearest points, the point itself counted as one at
    distance zero, must be below mean + std_ratio * standard deviation over the cloud: the maths of
    Open3D's ``remove_statistical_outlier``, which the paper uses.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    n_neighbors : int
    std_ratio : float

    Returns
    -------
    ndarray of shape (n_points,), bool
    """
    n_points = len(points)
    k = min(n_neighbors, n_points)
    tree = cKDTree(points)
    mean_distance = np.empty(n_points)
    for start in range(0, n_points, BLOCK):
        distances = tree.query(points[start : start + BLOCK], k=[*range(1, k + 1)], workers=-1)[0]
        mean_distance[start : start + BLOCK] = distances.mean(axis=1)
    if n_points < 2:
        return np.ones(n_points, bool)
    valid = mean_distance > 0  # Open3D leaves points out that coincide with all their neighbours
    if not valid.any():
        return np.ones(n_points, bool)
    limit = mean_distance[valid].mean() + std_ratio * mean_distance[valid].std(ddof=1)
    return mean_distance < limit


def nearest_depth(uv: np.ndarray, depth: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Depth buffer of projected points; infinite where nothing projects.

    Parameters
    ----------
    uv : ndarray of shape (n, 2), int
        Columns and rows inside ``shape``.
    depth : ndarray of shape (n,)
    shape : tuple of int
        Height and width.
    """
    buffer = np.full(shape, np.inf)
    np.minimum.at(buffer, (uv[:, 1], uv[:, 0]), depth)
    return buffer


def _visible(poses: Poses, i: int, points: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Rows of ``candidates`` that photo ``i`` sees: in the frame and not behind another point."""
    uv, depth = poses.project(points, i)
    width, height = int(poses.width[i]), int(poses.height[i])
    with np.errstate(invalid="ignore"):
        inside = (depth > 0) & (uv >= 0).all(axis=1) & (uv[:, 0] < width) & (uv[:, 1] < height)
    if not inside[candidates].any():
        return np.zeros(len(candidates), bool)
    scale = min(1.0, BUFFER_SIDE / max(width, height))
    shape = (int(height * scale) + 1, int(width * scale) + 1)
    cells = np.zeros(uv.shape, np.int64)
    cells[inside] = (uv[inside] * scale).astype(np.int64)
    buffer = nearest_depth(cells[inside], depth[inside], shape)
    own = cells[candidates]
    limit = buffer[own[:, 1], own[:, 0]] * (1 + DEPTH_TOLERANCE)
    return inside[candidates] & (depth[candidates] <= limit)


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
        A photo whose pixel is not sky sees the point only if its colour is this near.
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
                n_non_sky[rows] += ~is_sky & alike
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
        ``n_input``, ``n_removed_statistical``, ``n_sky_colored``, ``n_kept_by_photos``,
        ``n_removed_sky``, ``n_output``.

    Raises
    ------
    StageError
        When no point is left.
    """
    report = {"n_input": len(cloud), "n_removed_statistical": 0, "n_sky_colored": 0}
    report |= {"n_kept_by_photos": 0, "n_removed_sky": 0}
    if options.use_statistical:
        keep = statistical_inliers(cloud.points, options.n_neighbors, options.std_ratio)
        removed = int(np.count_nonzero(~keep))
        report["n_removed_statistical"] = removed
        logger.info("statistical filter: removed %s", _share(removed, len(cloud)))
        if removed == len(cloud):
            raise StageError(
                f"the statistical filter removed all {len(cloud):,} points", key="denoise.std_ratio"
            )
        cloud = cloud.select(keep)
    if options.use_sky:
        cloud, counts = _remove_sky(cloud, sky, evidence_of, options)
        report |= counts
    report["n_output"] = len(cloud)
    logger.info("denoising kept %s", _share(len(cloud), report["n_input"]))
    return cloud, report


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
