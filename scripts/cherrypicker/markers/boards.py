"""Boards of known layout in photos: ChArUco boards, and the faces of a checker cube.

A ChArUco board's corners are numbered by its markers. A cube's are not: a face is a grid of corners
that looks the same from two sides, and three faces look alike. So each grid is listed in all its
orders, and where the rays of most photos meet, as `layouts.meet` finds a marker, is a face.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from cherrypicker.markers.detection import marker_dictionary
from cherrypicker.markers.layouts import Sightings, lay_over, meet
from cherrypicker.markers.scan import Scan
from cherrypicker.sfm.features import SearchOptions

# Grids are sought in photos reduced to this longer side, corners refined in the full ones
_SEARCH_SIDE_PX = SearchOptions.max_image_size_px
_MAX_FACES = 3  # of a cube that one photo shows
# What a face's corners may be off a grid, of its extent, and faces in size (guess)
_IRREGULAR = 0.1
_REFINE_ROUNDS, _REFINED_PX = 30, 0.001  # cv2.cornerSubPix: steps at most, and what ends them


def charuco_board(values: Mapping) -> cv2.aruco.CharucoBoard:
    """OpenCV's board of a reference of kind ``charuco``."""
    sizes = values["squares"], values["length_m"], values["marker_m"]
    board = cv2.aruco.CharucoBoard(*sizes, marker_dictionary(values["dictionary"]))
    board.setLegacyPattern(bool(values.get("legacy", False)))
    return board


def see_charuco(values: Mapping, scan: Scan) -> tuple[Sightings, np.ndarray]:
    """A ChArUco board's inner corners in the photos of a scan, and their layout (k, 3), m."""
    layout = np.asarray(charuco_board(values).getChessboardCorners(), float)
    find = partial(find_charuco, values=values)
    return _see(scan, find, len(layout), "a ChArUco board"), layout


def see_cube(values: Mapping, scan: Scan) -> tuple[Sightings, np.ndarray]:
    """The inner corners of a checker cube's six faces: as `see_charuco`, each face a copy.

    Grids of corners that are the same face are told and numbered alike. The best seen face stands
    first; those of another size are other boards and left out.
    """
    n = values["cells"] - 1
    side = np.arange(n) * values["length_m"] / values["cells"]
    face = np.dstack([*np.meshgrid(side, side), np.zeros((n, n))]).reshape(-1, 3)
    k = len(face)
    grids = _see(scan, partial(_find_faces, n=n), k, "the checker cube")
    # Every grid in the eight orders in which it can be listed: one of them is that of its face
    order = np.arange(k).reshape(n, n)
    turns = [np.rot90(flipped, turn).ravel() for flipped in (order, order.T) for turn in range(4)]
    grid = np.repeat(np.arange(len(grids)), len(turns))
    listed = grids.select(grid)
    listed.places = grids.places[:, turns].reshape(-1, k, 2)
    # A corner is the same that is nearer than half a cell, and so than its neighbours
    near_px = listed.focal * _least_step(listed.places.reshape(-1, n, n, 2)) / 2
    places = np.full((len(grids), 6 * k, 2), np.nan)
    left, size, n_faces = np.arange(len(listed)), 0.0, 0
    while n_faces < 6:
        met = meet(listed.select(left), near_px[left], scan.seed)
        if met is None or len(np.unique(listed.photos[left[met[1]]])) < scan.min_images:
            break
        points, rows = met[0], left[met[1]]
        left = left[~np.isin(grid[left], grid[rows])]
        laid = lay_over(points, face)
        if laid is None or laid.misfit > _IRREGULAR:
            continue
        size = size or laid.size
        if abs(laid.size / size - 1) < _IRREGULAR:
            places[grid[rows], n_faces * k : (n_faces + 1) * k] = listed.places[rows]
            n_faces += 1
    return replace(grids, places=places).select(np.isfinite(places).any(axis=(1, 2))), face


def _see(scan: Scan, find: Callable[[np.ndarray], list], k: int, what: str) -> Sightings:
    """Boards or faces of k corners that a finder sees in photos, on undistorted coordinates."""

    def find_undistorted(grey: np.ndarray, camera: Any) -> list[tuple]:
        return [(camera.cam_from_img(corners), 0.0, 0.0) for corners in find(grey)]

    return scan.search(find_undistorted, what, Sightings, f"({k}, 2)f8, f8, f8")


def find_charuco(grey: np.ndarray, values: Mapping) -> list[np.ndarray]:
    """Corners (k, 2) of a ChArUco board in a grey photo, px, NaN if not seen; [] without one."""
    # A detector for each photo: OpenCV's own is not made for threads.
    detector = cv2.aruco.CharucoDetector(charuco_board(values))
    corners, ids, _, _ = detector.detectBoard(grey)
    if ids is None or len(ids) < 4:
        return []
    places = np.full((len(detector.getBoard().getChessboardCorners()), 2), np.nan)
    places[np.ravel(ids)] = np.reshape(corners, (-1, 2)) + 0.5
    return [places]


def _find_faces(grey: np.ndarray, n: int) -> list[np.ndarray]:
    """Corners (n * n, 2) of each face of a checker cube in a grey photo, px, row by row."""
    factor = min(1.0, _SEARCH_SIDE_PX / max(grey.shape))
    left = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _REFINE_ROUNDS, _REFINED_PX)
    found = []
    for _ in range(_MAX_FACES):
        is_there, corners = cv2.findChessboardCornersSB(left, (n, n), flags=cv2.CALIB_CB_EXHAUSTIVE)
        if not is_there:
            break
        places = np.reshape(corners, (n, n, 2)).astype(float)
        outline = places[[0, 0, -1, -1], [0, -1, -1, 0]]
        middle = outline.mean(axis=0)
        outline = middle + (outline - middle) * (n / (n - 1))
        cv2.fillConvexPoly(left, np.round(outline).astype(np.int32), int(np.median(left)))
        # Placed in the full photo, within a third of a cell: the search alone leaves the cube of
        # the tests 0.3 % too large, this 0.03 %.
        places = (places + 0.5) / factor
        window = max(int(_least_step(places) / 3), 2)
        start = np.ascontiguousarray(places.reshape(-1, 1, 2) - 0.5, np.float32)
        refined = cv2.cornerSubPix(grey, start, (window, window), (-1, -1), until)
        found.append(refined[:, 0].astype(float) + 0.5)
    return found


def _least_step(grids: np.ndarray) -> np.ndarray:
    """Least distance of neighbouring corners of grids (..., n, n, 2)."""
    across, down = (np.linalg.norm(np.diff(grids, axis=axis), axis=-1) for axis in (-2, -3))
    return np.minimum(across.min(axis=(-1, -2)), down.min(axis=(-1, -2)))
