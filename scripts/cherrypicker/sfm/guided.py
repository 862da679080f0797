"""Guided matching: more matches between photos whose epipolar geometry is known.

Features are compared with those near their epipolar line only, so the ratio test no longer fails
on texture that repeats elsewhere. COLMAP has the same step; on a CPU it compares all features with
all and takes about a second a pair of 6000 features, the kernel below about a tenth of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import pycolmap

_GEOMETRY = pycolmap.TwoViewGeometryConfiguration
_PLANAR = (_GEOMETRY.PLANAR, _GEOMETRY.PANORAMIC, _GEOMETRY.PLANAR_OR_PANORAMIC)
# COLMAP stores unit descriptors as bytes, 512 for 1.
_UNIT_DOT = 512.0 * 512.0


@dataclass(frozen=True)
class PhotoFeatures:
    """Features of a photo.

    Attributes
    ----------
    pixels : ndarray of shape (n, 2), float64
        Positions in the photo, px.
    rays : ndarray of shape (n, 2), float64
        Undistorted positions relative to the principal point, px (tangents times focal length).
    descriptors : ndarray of shape (n, 128), uint8
    focal : float
        Focal length, px.
    """

    pixels: np.ndarray
    rays: np.ndarray
    descriptors: np.ndarray
    focal: float


def read_features(database: pycolmap.Database, image_id: int) -> PhotoFeatures:
    """Read a photo's features with the camera that the database knows."""
    camera = database.read_camera(database.read_image(image_id).camera_id)
    keypoints = np.asarray(database.read_keypoints(image_id))
    descriptors = np.asarray(database.read_descriptors(image_id).data, dtype=np.uint8)
    pixels = np.ascontiguousarray(keypoints[:, :2], dtype=np.float64).reshape(-1, 2)
    focal = float(camera.mean_focal_length())
    rays = np.asarray(camera.cam_from_img(pixels), dtype=np.float64).reshape(-1, 2) * focal
    return PhotoFeatures(
        pixels, np.ascontiguousarray(rays), np.ascontiguousarray(descriptors), focal
    )


def guided_matches(
    first: PhotoFeatures,
    second: PhotoFeatures,
    geometry: pycolmap.TwoViewGeometry,
    *,
    max_error_px: float,
    max_ratio: float,
    max_distance: float,
) -> np.ndarray:
    """Match features that a two-view geometry allows to be the same point.

    Parameters
    ----------
    first, second : PhotoFeatures
    geometry : pycolmap.TwoViewGeometry
        Verified geometry of the pair.
    max_error_px : float
        Largest Sampson error (or transfer error where the scene is planar), px.
    max_ratio : float
        Largest ratio of best to second best descriptor angle, among the allowed ones.
    max_distance : float
        Largest descriptor angle, rad.

    Returns
    -------
    ndarray of shape (n_matches, 2), uint32
        Mutually best matches, by feature of the first photo.
    """
    if geometry.config in _PLANAR and geometry.H is not None:
        points1, points2, matrix = first.pixels, second.pixels, np.array(geometry.H)
    elif geometry.config == _GEOMETRY.CALIBRATED and geometry.E is not None:
        points1, points2 = first.rays, second.rays
        to_unit1 = np.diag([1.0 / first.focal, 1.0 / first.focal, 1.0])
        to_unit2 = np.diag([1.0 / second.focal, 1.0 / second.focal, 1.0])
        matrix = to_unit2 @ np.array(geometry.E) @ to_unit1
    elif geometry.F is not None:
        points1, points2, matrix = first.pixels, second.pixels, np.array(geometry.F)
    else:
        return np.empty((0, 2), dtype=np.uint32)
    planar = geometry.config in _PLANAR and geometry.H is not None
    return _match(
        points1,
        points2,
        first.descriptors,
        second.descriptors,
        np.ascontiguousarray(matrix, dtype=np.float64),
        planar,
        max_error_px,
        max_ratio,
        max_distance,
    )


@numba.njit(nogil=True, cache=True)
def _match(
    points1, points2, descriptors1, descriptors2, matrix, planar, max_error, ratio, distance
):
    n1, n2 = len(points1), len(points2)
    best1 = np.full(n1, -1, np.int64)
    best_dot1, second_dot1 = np.zeros(n1, np.int32), np.zeros(n1, np.int32)
    best2 = np.full(n2, -1, np.int64)
    best_dot2, second_dot2 = np.zeros(n2, np.int32), np.zeros(n2, np.int32)
    back_lines = np.empty((n2, 2))
    for j in range(n2):
        for axis in range(2):
            back_lines[j, axis] = (
                points2[j, 0] * matrix[0, axis] + points2[j, 1] * matrix[1, axis] + matrix[2, axis]
            )
    limit = max_error * max_error
    for i in range(n1):
        a = matrix[0, 0] * points1[i, 0] + matrix[0, 1] * points1[i, 1] + matrix[0, 2]
        b = matrix[1, 0] * points1[i, 0] + matrix[1, 1] * points1[i, 1] + matrix[1, 2]
        c = matrix[2, 0] * points1[i, 0] + matrix[2, 1] * points1[i, 1] + matrix[2, 2]
        for j in range(n2):
            if planar:
                error = (points2[j, 0] * c - a) ** 2 + (points2[j, 1] * c - b) ** 2
                allowed = error <= limit * c * c
            else:
                residual = a * points2[j, 0] + b * points2[j, 1] + c
                gradient = a * a + b * b + back_lines[j, 0] ** 2 + back_lines[j, 1] ** 2
                allowed = residual * residual <= limit * gradient
            if not allowed:
                continue
            dot = np.int32(0)
            for k in range(descriptors1.shape[1]):
                dot += np.int32(descriptors1[i, k]) * np.int32(descriptors2[j, k])
            if dot > best_dot1[i]:
                second_dot1[i], best_dot1[i], best1[i] = best_dot1[i], dot, j
            elif dot > second_dot1[i]:
                second_dot1[i] = dot
            if dot > best_dot2[j]:
                second_dot2[j], best_dot2[j], best2[j] = best_dot2[j], dot, i
            elif dot > second_dot2[j]:
                second_dot2[j] = dot
    matches = np.empty((min(n1, n2), 2), np.uint32)
    n = 0
    for i in range(n1):
        j = best1[i]
        if j < 0 or best2[j] != i:
            continue
        angle = np.arccos(min(best_dot1[i] / _UNIT_DOT, 1.0))
        second1 = np.arccos(min(second_dot1[i] / _UNIT_DOT, 1.0))
        second2 = np.arccos(min(second_dot2[j] / _UNIT_DOT, 1.0))
        if angle <= distance and angle < ratio * second1 and angle < ratio * second2:
            matches[n, 0], matches[n, 1] = i, j
            n += 1
    return matches[:n]
