"""Printed square markers (ArUco, AprilTag) in photos: detection and precise corners."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.markers.columns import check_ids
from cherrypicker.markers.fit import fit_marker
from cherrypicker.photos import read_photo
from cherrypicker.progress import Progress

logger = logging.getLogger(__name__)

T = TypeVar("T")

# A marker that explains less of the grey values than this is no such marker, or is covered: on
# foreign_b, phone_b and cherry_vase markers explain 0.97 and more, bricks read as one 0.90 at most
_MIN_AGREEMENT = 0.93
_COARSE_STD_PX = 1.0  # of corners that no pattern was fitted to (guess), or this many sides
_COARSE_STD_SIDES = 0.02
_LEAST_STD_PX = 0.02  # no fit is better (guess)
_REACH_PX, _REACH_MODULES = 1.5, 1.5  # a fit stays this near to the coarse corners (guess)
# Photos up to this size are searched at twice the size for small markers (guess)
_UPSCALE_BELOW_PX = 4_000_000
# OpenCV's search: a marker's least side, px, and perimeter (OpenCV's own), a share of the photo's
# longer side
_LEAST_SIDE_PX, _LEAST_PERIMETER = 12, 0.03
_COMMON_DICTIONARIES = (
    "DICT_4X4_50",
    "DICT_5X5_250",
    "DICT_6X6_250",
    "DICT_7X7_250",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h11",
)


@dataclass(frozen=True)
class Detection:
    """A marker seen in one photo."""

    photo: int  # index of the photo
    marker_id: int
    # (4, 2): undistorted, as normalised camera coordinates x / z, y / z, clockwise from the
    # pattern's top left
    corners: np.ndarray
    focal: float  # mean focal length of the camera, px: normalised coordinates times it are pixels
    corner_std: float  # one standard deviation of a corner coordinate, px
    side_px: float  # mean side in the photo, px
    is_precise: bool  # false where the pattern is not matched, or the paper is not flat
    is_matched: bool  # whether the pattern is matched
    coarse: np.ndarray  # (4, 2): the corners before the pattern was fitted

    @property
    def coarse_std(self) -> float:
        """One standard deviation of a coarse corner's coordinate, px."""
        return max(_COARSE_STD_PX, _COARSE_STD_SIDES * self.side_px)


def marker_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's marker dictionary of a name such as ``DICT_4X4_50`` or ``DICT_APRILTAG_36h11``.

    Raises
    ------
    StageError
        If OpenCV has no such dictionary.
    """
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, check_ids(name)))


def marker_pattern(dictionary: cv2.aruco.Dictionary, marker_id: int) -> np.ndarray:
    """Cells of a marker with its black border, (n, n), 0 black and 1 white."""
    n_modules = dictionary.markerSize + 2
    return (dictionary.generateImageMarker(marker_id, n_modules, borderBits=1) > 127).astype(float)


def find_markers(
    grey: np.ndarray, dictionary: cv2.aruco.Dictionary
) -> list[tuple[int, np.ndarray]]:
    """Coarse marker corners in a photo.

    Parameters
    ----------
    grey : ndarray of shape (height, width), uint8

    Returns
    -------
    list of (int, ndarray of shape (4, 2))
        Ids and corners, px, pixel centres at (0.5, 0.5). An id can occur more than once.
    """
    factor = 2.0 if grey.size <= _UPSCALE_BELOW_PX else 1.0
    larger = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    found = _detect(larger, dictionary, factor)
    return sorted(found, key=lambda item: (item[0], *item[1].mean(axis=0)))


def _detect(
    grey: np.ndarray, dictionary: cv2.aruco.Dictionary, factor: float
) -> list[tuple[int, np.ndarray]]:
    parameters = cv2.aruco.DetectorParameters()
    longest = max(grey.shape)
    least = 4 * _LEAST_SIDE_PX * factor / longest
    parameters.minMarkerPerimeterRate = min(_LEAST_PERIMETER, least)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
    if ids is None:
        return []
    # OpenCV puts pixel centres at whole numbers, COLMAP at halves.
    return [
        (int(marker_id), (quad.reshape(4, 2).astype(float) + 0.5) / factor)
        for marker_id, quad in zip(ids.ravel(), corners)
    ]


def detect_markers(
    photos: Sequence[str | Path],
    cameras: Sequence[Any],
    dictionary: cv2.aruco.Dictionary,
    *,
    threads: int = 1,
) -> list[Detection]:
    """Find a dictionary's markers in all photos, with sub-pixel corners on undistorted coordinates.

    What only looks like a marker is among them: a black brick is read as one with few white cells.

    Parameters
    ----------
    photos : list of path-like
        Photo files as COLMAP read them.
    cameras : list of pycolmap.Camera
        The camera of each photo.

    Returns
    -------
    list of Detection
        In the order of the photos.

    Raises
    ------
    StageError
        If a photo cannot be read or does not have the size of its camera.
    """

    def find(index: int, grey: np.ndarray) -> list[Detection | None]:
        camera = cameras[index]
        if grey.shape != (camera.height, camera.width):
            raise StageError(
                f"the photo has {grey.shape[1]} x {grey.shape[0]} px, its camera in the sparse "
                f"model {camera.width} x {camera.height}",
                file=photos[index],
                key="photos in trees.tsv",
            )
        return [
            _refine(index, marker_id, corners, grey, camera, marker_pattern(dictionary, marker_id))
            for marker_id, corners in find_markers(grey, dictionary)
        ]

    found = search_photos(photos, find, "markers", threads=threads)
    return [detection for each in found for detection in each if detection is not None]


def search_photos(
    photos: Sequence[str | Path],
    find: Callable[[int, np.ndarray], list[T]],
    what: str,
    *,
    threads: int = 1,
) -> list[list[T]]:
    """What `find` tells of each photo, given its index and its grey values."""

    def search(index: int) -> list[T]:
        return find(index, cv2.cvtColor(read_photo(photos[index]), cv2.COLOR_RGB2GRAY))

    found = []
    with (
        ThreadPoolExecutor(max(1, threads)) as pool,
        Progress(len(photos), f"photos searched for {what}") as bar,
    ):
        for each in pool.map(search, range(len(photos))):
            found.append(each)
            bar.step()
    return found


def _refine(
    index: int,
    marker_id: int,
    corners: np.ndarray,
    grey: np.ndarray,
    camera: Any,
    pattern: np.ndarray,
) -> Detection | None:
    """Precise corners of a coarse detection; the coarse ones where the fit fails."""
    focal = float(np.mean([camera.focal_length_x, camera.focal_length_y]))

    def undistorted_px(pixels: np.ndarray) -> np.ndarray:
        return np.asarray(camera.cam_from_img(np.ascontiguousarray(pixels)), float) * focal

    start = undistorted_px(corners)
    if not np.isfinite(start).all():
        return None
    side = float(np.mean(np.linalg.norm(start - np.roll(start, 1, axis=0), axis=1)))
    detection = Detection(
        photo=index,
        marker_id=marker_id,
        corners=start / focal,
        focal=focal,
        corner_std=np.inf,
        side_px=side,
        is_precise=False,
        is_matched=False,
        coarse=start / focal,
    )
    coarse = detection.coarse_std
    fit = fit_marker(grey, corners, pattern, undistorted_px)
    reach = max(_REACH_PX, _REACH_MODULES * side / len(pattern))
    if fit is None or fit.agreement < _MIN_AGREEMENT or np.abs(fit.corners - start).max() >= reach:
        return replace(detection, corner_std=coarse)
    std = max(fit.corner_std, _LEAST_STD_PX) if fit.is_flat else 0.5 * coarse
    return replace(
        detection,
        corners=fit.corners / focal,
        corner_std=std,
        is_precise=fit.is_flat,
        is_matched=True,
    )


def suggest_dictionaries(photos: Sequence[str | Path], *, n_photos: int = 6) -> str:
    """Which other dictionaries find markers in a few of the photos, for an error message.

    Returns
    -------
    str
        Empty where none does.
    """
    step = max(1, len(photos) // n_photos)
    greys = [
        cv2.cvtColor(read_photo(path), cv2.COLOR_RGB2GRAY) for path in photos[::step][:n_photos]
    ]
    hits = []
    for name in _COMMON_DICTIONARIES:
        dictionary = marker_dictionary(name)
        ids = Counter(
            marker_id
            for grey in greys
            for marker_id in {marker for marker, _ in _detect(grey, dictionary, 1.0)}
        )
        seen = sorted(marker_id for marker_id, count in ids.items() if count >= 2)
        if seen:
            hits.append(f"{name} finds id {', '.join(map(str, seen[:5]))}")
    return "; ".join(hits)
