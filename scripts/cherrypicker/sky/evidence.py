"""What the photos say about single points of a cloud: sky seen through them, or something there.

A point that stereo put beside a branch bears the sky's colour, and so does a point on a twig that
is thinner than a pixel. Their colour does not tell them apart, their place does: a twig covers
every photo's line of sight to within the cloud's error, which is about a pixel of the depth maps,
while the sky shows clear through a point beside it in all photos but those that look along it. So
sky counts against a point only with nothing else within that pixel.

Nor does the mask decide alone, since masks lose twigs: a thin dark structure that the photo itself
shows is no clear sky, whatever its mask says.

Most photos look past a branch at the ground and say nothing: their pixel is no sky, whether the
branch is there or not. They would outvote the few that look up. So a photo that shows no sky at a
point counts only where it could have shown some, with sky a few pixels aside, or where its pixel
has the point's own colour.

None of this is in the paper, whose sky filter goes by colour alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from cherrypicker.pointcloud import PointCloud
from cherrypicker.poses import Poses
from cherrypicker.progress import Progress

#: Longer side of the depth buffers that decide which photos see a point, pixels.
BUFFER_SIDE = 500
#: A point is seen when it lies at most this share of its depth behind the nearest surface.
DEPTH_TOLERANCE = 0.01
#: A photo could show sky at a pixel when it has sky this near, pixels of the depth map.
SKY_REACH = 6
#: A pixel of the depth map is sky when its mask says so for this share of it.
SKY_SHARE = 0.75
#: Widest structure that counts as thin, and how far one structure drowns fainter ones, pixels.
THIN_WIDTH, THIN_REACH = 10, 4
#: A pixel belongs to a thin structure from this share of the strongest contrast around it: less is
#: the blur beside a twig.
THIN_SHARE = 0.5
#: Contrast of thin structures over that of most of the sky, which is noise.
NOISE_RATIO = 2.0

#: What a photo shows at a pixel: no sky near, clear sky, or something with sky near.
AWAY, CLEAR, SOLID = 0, 1, 2


@dataclass(frozen=True)
class SkyEvidence:
    """How the photos see some points.

    Attributes
    ----------
    n_clear : ndarray of shape (n,), int32
        Photos that show clear sky where the point should be, nothing of the cloud before it.
    n_solid : ndarray of shape (n,), int32
        Photos that show something there, though sky is near.
    n_alike : ndarray of shape (n,), int32
        Photos that show something there of the point's colour, far from any sky.
    """

    n_clear: np.ndarray
    n_solid: np.ndarray
    n_alike: np.ndarray


@dataclass(frozen=True)
class EvidenceOptions:
    """Settings of `sky_evidence`.

    Attributes
    ----------
    depth_side_px : int
        Longer side of the depth maps; larger photos are reduced to it. 0 for photos as they are.
    clearance_px : int
        Sky is clear with nothing else this near, pixels of the depth map.
    twig_contrast : float
        A thin structure this much darker in blue than what surrounds it is no clear sky; 0 leaves
        it to the masks alone.
    same_color_distance : float
        A pixel whose colour is this near to the point's shows the point.
    """

    depth_side_px: int = 1600
    clearance_px: int = 1
    twig_contrast: float = 0.05
    same_color_distance: float = 0.15


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


def _visible(poses: Poses, i: int, surface: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which of ``points`` photo ``i`` sees: in the frame and not behind ``surface``."""
    uv, depth = poses.project(points, i)
    width, height = int(poses.width[i]), int(poses.height[i])
    with np.errstate(invalid="ignore"):
        inside = (depth > 0) & (uv >= 0).all(axis=1) & (uv[:, 0] < width) & (uv[:, 1] < height)
    if not inside.any():
        return inside
    scale = min(1.0, BUFFER_SIDE / max(width, height))
    buffer = np.full((int(height * scale) + 1, int(width * scale) + 1), np.inf)
    _depth_buffer(surface, poses.cam_from_world[i], poses.K[i], scale, buffer)
    column, line = (uv[inside] * scale).astype(np.int64).T
    inside[inside] = depth[inside] <= buffer[line, column] * (1 + DEPTH_TOLERANCE)
    return inside


def _square(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


def thin_structures(image: np.ndarray, clear: np.ndarray, contrast: float) -> np.ndarray:
    """Find what is thin and darker in blue than its surroundings, to within a pixel.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
    clear : ndarray of shape (H, W), bool
        Sky by the mask, from which the noise is learnt.
    contrast : float
        Least contrast, a share of the full range.

    Returns
    -------
    ndarray of shape (H, W), bool
    """
    blue = np.ascontiguousarray(image[..., 2])
    depth = cv2.subtract(cv2.morphologyEx(blue, cv2.MORPH_CLOSE, _square(THIN_WIDTH // 2)), blue)
    near = cv2.dilate(depth, _square(1))
    # Most of the sky shows no twig, even where the mask took all twigs for sky.
    noise = float(np.median(near[clear])) if clear.any() else 0.0
    least = max(255 * contrast, NOISE_RATIO * noise)
    around = cv2.dilate(depth, _square(THIN_REACH))
    return (near >= least) & (near >= THIN_SHARE * around)


def photo_evidence(
    image: np.ndarray, sky: np.ndarray, options: EvidenceOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Say of every pixel of a photo whether it shows clear sky or something before the sky.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
    sky : ndarray of shape (H, W), bool
    options : EvidenceOptions

    Returns
    -------
    kind : ndarray of shape (h, w), uint8
        `AWAY`, `CLEAR` or `SOLID`; at most ``depth_side_px`` on the longer side.
    image : ndarray of shape (h, w, 3), uint8
        The photo at that size.
    """
    scale = options.depth_side_px / max(sky.shape)
    if 0 < scale < 1:
        size = (max(1, round(sky.shape[1] * scale)), max(1, round(sky.shape[0] * scale)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        share = cv2.resize(sky.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
        sky = share >= 255 * SKY_SHARE
    is_sky = sky.astype(np.uint8)
    clear = cv2.erode(is_sky, _square(options.clearance_px)) > 0
    if options.twig_contrast > 0 and clear.any():
        clear &= ~thin_structures(image, clear, options.twig_contrast)
    kind = np.where(cv2.dilate(is_sky, _square(SKY_REACH)) > 0, SOLID, AWAY).astype(np.uint8)
    kind[clear] = CLEAR
    return kind, image


def sky_evidence(
    surface: np.ndarray,
    asked: PointCloud,
    poses: Poses,
    to_photo: Callable[[int, np.ndarray], np.ndarray],
    look: Callable[[int], tuple[np.ndarray, np.ndarray]],
    options: EvidenceOptions,
) -> SkyEvidence:
    """Ask all photos about some points.

    Parameters
    ----------
    surface : ndarray of shape (n_points, 3), float64
        All points that can hide others.
    asked : PointCloud
        The n points asked about; without colours ``n_alike`` stays zero.
    poses : Poses
        In the cloud's frame; undistorted pinhole.
    to_photo : callable
        ``to_photo(i, in_camera)`` projects camera coordinates (m, 3) to the pixels (m, 2) of the
        photo as stored, lens distortion included.
    look : callable
        ``look(i)`` returns the photo, (H, W, 3) uint8, and its sky mask, (H, W) bool.
    options : EvidenceOptions
    """
    counts = np.zeros((3, len(asked)), np.int32)
    with Progress(len(poses), "photos asked about sky silhouettes") as bar:
        for i in range(len(poses)):
            rows = np.flatnonzero(_visible(poses, i, surface, asked.points))
            if len(rows):
                photo, sky = look(i)
                in_camera = asked.points[rows] @ poses.rotations[i].T
                uv = to_photo(i, in_camera + poses.cam_from_world[i, :, 3])
                with np.errstate(invalid="ignore"):
                    inside = (uv >= 0).all(axis=1) & (uv < sky.shape[::-1]).all(axis=1)
                rows = rows[inside]
                kind, image = photo_evidence(photo, sky, options)
                ratio = np.divide(kind.shape[::-1], sky.shape[::-1])
                column, line = (uv[inside] * ratio).astype(np.int64).T
                shown = kind[line, column]
                counts[0, rows] += shown == CLEAR
                counts[1, rows] += shown == SOLID
                if asked.colors is not None:
                    offset = image[line, column] / 255.0 - asked.colors[rows]
                    is_alike = np.linalg.norm(offset, axis=1) <= options.same_color_distance
                    counts[2, rows] += (shown == AWAY) & is_alike
            bar.step()
    return SkyEvidence(*counts)
