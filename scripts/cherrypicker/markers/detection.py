"""Printed square markers (ArUco, AprilTag) in photos: detection and precise corners."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from cherrypicker.markers.fit import fit_marker
from cherrypicker.markers.layouts import MOST_OFF, Sightings
from cherrypicker.markers.references import check_ids
from cherrypicker.markers.scan import Scan

# A marker that explains less of the grey values than this is no such marker, or is covered: on
# foreign_b, phone_b and cherry_vase markers explain 0.97 and more, bricks read as one 0.90 at most
_MIN_AGREEMENT = 0.93
# Photos up to this size are searched at twice the size for small markers (bounds the time): in
# photos of three scans at four sizes that finds 192 of 212 of 10 to 100 px, without it 185
_UPSCALE_BELOW_PX = 4_000_000
# Markers of these are looked for beside those that a table names (OpenCV's families)
_COMMON_DICTIONARIES = (
    *("DICT_4X4_50", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250", "DICT_ARUCO_ORIGINAL"),
    *("DICT_APRILTAG_16h5", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h11"),
)


@dataclass
class Reads(Sightings):
    """Markers as a detector reads them: the places are corners, clockwise from the top left."""

    dictionaries: np.ndarray  # (n,) str: OpenCV's names
    ids: np.ndarray  # (n,) int
    is_matched: np.ndarray  # (n,) bool: whether the pattern is matched
    is_precise: np.ndarray  # (n,) bool: whether the paper is flat too

    def of(self, dictionary: str, marker_id: int) -> Reads:
        """Those of one marker."""
        return self.select((self.dictionaries == dictionary) & (self.ids == marker_id))


def marker_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's marker dictionary of a name, as :func:`check_ids` takes it and refuses it."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, check_ids(name)))


def marker_pattern(dictionary: cv2.aruco.Dictionary, marker_id: int) -> np.ndarray:
    """Cells of a marker with its black border, (n, n), 0 black and 1 white."""
    n_modules = dictionary.markerSize + 2
    return (dictionary.generateImageMarker(marker_id, n_modules, borderBits=1) > 127).astype(float)


def dictionaries_beside(names: Sequence[str]) -> dict[str, cv2.aruco.Dictionary]:
    """The dictionaries of these names, and of common ones those that share no marker with them."""
    result = {name: marker_dictionary(name) for name in names}
    first = [dictionary.bytesList[0] for dictionary in result.values()]  # the longer go on from it
    for name in _COMMON_DICTIONARIES:
        common = marker_dictionary(name)
        if not any(np.array_equal(common.bytesList[0], each) for each in first):
            result[name] = common
    return result


def find_markers(
    grey: np.ndarray, dictionaries: Mapping[str, cv2.aruco.Dictionary]
) -> list[tuple[str, int, np.ndarray]]:
    """Coarse marker corners in a photo (height, width), uint8.

    Names of the dictionaries, ids and corners (4, 2), px, pixel centres at (0.5, 0.5). An id can
    occur more than once.
    """
    if not dictionaries:
        return []
    factor = 2.0 if grey.size <= _UPSCALE_BELOW_PX else 1.0
    larger = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    parameters = cv2.aruco.DetectorParameters()
    # Two pixels for each of the fewest cells, its black border's among them
    least = 2 * (2 + min(each.markerSize for each in dictionaries.values()))
    rate = 4 * least * factor / max(larger.shape)
    parameters.minMarkerPerimeterRate = min(parameters.minMarkerPerimeterRate, rate)
    detector = cv2.aruco.ArucoDetector(list(dictionaries.values()), parameters)
    quads, ids, _, numbers = detector.detectMarkersMultiDict(larger)
    if ids is None:
        return []
    names = np.array(list(dictionaries))
    # OpenCV puts pixel centres at whole numbers, COLMAP at halves.
    found = [
        (str(name), int(marker_id), (quad.reshape(4, 2).astype(float) + 0.5) / factor)
        for name, marker_id, quad in zip(names[numbers.ravel()], ids.ravel(), quads)
    ]
    return sorted(found, key=lambda item: (*item[:2], *item[2].mean(axis=0)))


def detect_markers(scan: Scan, names: Sequence[str]) -> Reads:
    """Find markers in all photos, with sub-pixel corners on undistorted coordinates.

    Those of the dictionaries of these names and of common ones. What only looks like a marker is
    among them: a black brick is read as one with few white cells.

    Raises
    ------
    StageError
        As of :meth:`cherrypicker.markers.scan.Scan.search`.
    """
    dictionaries = dictionaries_beside(names)

    def find(grey: np.ndarray, camera: Any) -> list[tuple]:
        focal, found = camera.mean_focal_length(), []

        def undistorted_px(pixels: np.ndarray) -> np.ndarray:
            return camera.cam_from_img(np.ascontiguousarray(pixels)) * focal

        for name, marker_id, corners in find_markers(grey, dictionaries):
            pattern = marker_pattern(dictionaries[name], marker_id)
            places = undistorted_px(corners)
            if not np.isfinite(places).all():  # off the lens
                continue
            side = float(np.mean(np.linalg.norm(places - np.roll(places, 1, axis=0), axis=1)))
            std = MOST_OFF * side  # of corners that no pattern was fitted to
            fit = fit_marker(grey, corners, pattern, undistorted_px)
            is_matched = is_precise = False
            if fit and fit.agreement >= _MIN_AGREEMENT:
                places, is_matched, is_precise = fit.corners, True, fit.is_flat
                std = fit.corner_std if is_precise else 0.5 * std
            found.append((places / focal, std, side, name, marker_id, is_matched, is_precise))
        return found

    return scan.search(find, "markers", Reads, "(4, 2)f8, f8, f8, U32, i8, ?, ?")
