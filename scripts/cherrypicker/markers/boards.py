"""Boards of known layout in photos: ChArUco boards, and the faces of a checker cube.

A ChArUco board's corners are numbered by its markers. A cube's are not: a face is a grid of corners
that looks the same from two sides, and three faces look alike. Two photos' grids are the same face
if their corners, located from both, are a regular grid; the pair that most other photos agree with
names the corners in all of them, as `layouts.consensus` finds a marker.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from typing import Any

import cv2
import numpy as np

from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.markers.detection import marker_dictionary
from cherrypicker.markers.layouts import Sightings, intersect_rays, lay_over

_MAX_FACES = 3  # of a cube that one photo shows
# Guesses. Grids are sought in photos reduced to this longer side, corners refined in the full ones
_SEARCH_SIDE_PX = 2400
_MAX_PAIRS, _MIN_PARALLAX_DEG = 600, 3.0
_IRREGULAR = 0.1  # what corners located from two photos may be off a grid, of its extent
_NEAR_CELLS = 0.25  # of a grid's spacing in a photo: a corner this near is the same
_REFINE_ROUNDS, _REFINED_PX = 30, 0.001  # cv2.cornerSubPix: steps at most, and what ends them


def charuco_board(values: Any) -> cv2.aruco.CharucoBoard:
    """OpenCV's board of a reference of kind ``charuco``."""
    dictionary = marker_dictionary(values["dictionary"])
    squares, sides = tuple(values["squares"]), (values["length_m"], values["marker_m"])
    board = cv2.aruco.CharucoBoard(squares, *sides, dictionary)
    board.setLegacyPattern(bool(values.get("legacy", False)))
    return board


def charuco_layout(values: Any) -> tuple[np.ndarray, np.ndarray]:
    """Places of a board's inner corners (n, 3), m, and their part: one."""
    corners = np.asarray(charuco_board(values).getChessboardCorners(), float)
    return corners, np.zeros(len(corners), int)


def cube_layout(values: Any) -> tuple[np.ndarray, np.ndarray]:
    """Places of the inner corners of a cube's faces (n, 3), m, and the face of each."""
    n = values["cells"] - 1
    side = np.arange(n) * values["length_m"] / values["cells"]
    face = np.stack([*np.meshgrid(side, side), np.zeros((n, n))], axis=-1).reshape(-1, 3)
    # Six faces, of which a standing cube shows five.
    return np.tile(face, (6, 1)), np.repeat(np.arange(6), n * n)


def charuco_finder(values: Any) -> Callable[[np.ndarray], list[np.ndarray]]:
    """Return what finds a ChArUco board in a grey photo: corners (n, 2), px, NaN if not seen."""

    def find(grey: np.ndarray) -> list[np.ndarray]:
        # A detector for each photo: OpenCV's own is not made for threads.
        detector = cv2.aruco.CharucoDetector(charuco_board(values))
        corners, ids, _, _ = detector.detectBoard(grey)
        if ids is None or len(ids) < 4:
            return []
        places = np.full((len(detector.getBoard().getChessboardCorners()), 2), np.nan)
        places[np.ravel(ids)] = np.reshape(corners, (-1, 2)) + 0.5
        return [places]

    return find


def cube_finder(values: Any) -> Callable[[np.ndarray], list[np.ndarray]]:
    """Return what finds the faces of a checker cube in a grey photo: the corners of each, px."""
    n = values["cells"] - 1

    def find(grey: np.ndarray) -> list[np.ndarray]:
        factor = min(1.0, _SEARCH_SIDE_PX / max(grey.shape))
        left = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        found = []
        for _ in range(_MAX_FACES):
            is_there, corners = cv2.findChessboardCornersSB(
                left, (n, n), flags=cv2.CALIB_CB_EXHAUSTIVE
            )
            if not is_there:
                break
            places = np.reshape(corners, (n, n, 2)).astype(float)
            outline = places[[0, 0, -1, -1], [0, -1, -1, 0]]
            middle = outline.mean(axis=0)
            outline = middle + (outline - middle) * (n / (n - 1))
            cv2.fillConvexPoly(left, np.round(outline).astype(np.int32), int(np.median(left)))
            found.append(_refined(grey, (places.reshape(-1, 2) + 0.5) / factor, n))
        return found

    return find


def _refined(grey: np.ndarray, places: np.ndarray, n: int) -> np.ndarray:
    """Corners placed in the full photo; the window stays within a third of a cell.

    The search alone leaves the cube of the tests 0.3 % too large, this 0.03 %.
    """
    grid = places.reshape(n, n, 2)
    cell = min(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1))
    window = max(int(cell / 3), 2)
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _REFINE_ROUNDS, _REFINED_PX)
    start = np.ascontiguousarray((places - 0.5)[:, None], np.float32)
    return (
        cv2.cornerSubPix(grey, start, (window, window), (-1, -1), until)[:, 0].astype(float) + 0.5
    )


def sightings_of(
    found: list[list[np.ndarray]], cameras: list, cam_from_world: np.ndarray
) -> Sightings:
    """Boards or faces, the corners (k, 2) of each by photo, on undistorted coordinates."""
    photos = np.repeat(np.arange(len(found)), [len(each) for each in found])
    boards = [
        np.asarray(camera.cam_from_img(np.ascontiguousarray(corners)), float)
        for each, camera in zip(found, cameras)
        for corners in each
    ]
    focal = [np.mean([camera.focal_length_x, camera.focal_length_y]) for camera in cameras]
    none = np.zeros(len(photos))
    return Sightings(
        photos=photos,
        cam_from_world=cam_from_world[photos],
        focal=np.array(focal)[photos],
        places=np.reshape(boards, (len(photos), -1, 2)) if boards else np.zeros((0, 0, 2)),
        std=none,
        side_px=none,
    )


def name_faces(grids: Sightings, n: int, *, min_photos: int, seed: int) -> Sightings:
    """Tell which grids of corners are the same face of a cube, and number their corners alike.

    Parameters
    ----------
    grids : Sightings
        Grids of n x n corners, row by row, of all photos.
    n : int
        Inner corners along an edge.
    min_photos : int
        Photos that must show a face.

    Returns
    -------
    Sightings
        Of six faces, the best seen first; those farther from the first than its cube reaches are
        other boards and left out.
    """
    left, k = np.ones(len(grids), bool), n * n
    places = np.full((len(grids), 6 * k, 2), np.nan)
    first, n_faces = None, 0
    while n_faces < 6:
        rows = np.flatnonzero(left)
        located = _best_face(grids.select(rows), n, seed)
        if located is None:
            break
        matches = [(row, _match(grids, row, located, n)) for row in rows.tolist()]
        orders = {row: order for row, order in matches if order is not None}
        members = list(orders)
        if len(np.unique(grids.photos[members])) < min_photos:
            break
        left[members] = False
        middle, spacing = located.mean(axis=0), _fit_grid(located, n)[0]
        first = first or (middle, spacing)
        # Centres of two faces of a cube are an edge apart at most, n + 1 cells.
        is_near = np.linalg.norm(middle - first[0]) < 1.2 * (n + 1) * first[1]
        if is_near and abs(spacing / first[1] - 1) < _IRREGULAR:
            for row, order in orders.items():
                places[row, n_faces * k + order] = grids.places[row]
            n_faces += 1
    return replace(grids, places=places).select(np.isfinite(places).any(axis=(1, 2)))


def _best_face(grids: Sightings, n: int, seed: int) -> np.ndarray | None:
    """Corners (n * n, 3) of the face that most photos agree on."""
    # The eight orders in which the same grid of n x n corners can be listed
    order = np.arange(n * n).reshape(n, n)
    turns = [np.rot90(flipped, k).ravel() for flipped in (order, order.T) for k in range(4)]
    rays, centers = grids.rays, grids.centers
    middle = rays.mean(axis=1)
    pairs = [
        (a, b)
        for a, b in combinations(range(len(grids)), 2)
        if grids.photos[a] != grids.photos[b]
        and middle[a] @ middle[b] <= np.cos(np.radians(_MIN_PARALLAX_DEG))
    ]
    best: tuple[float, np.ndarray] | None = None
    for a, b in thin_randomly(np.reshape(pairs, (-1, 2)).astype(int), _MAX_PAIRS, seed):
        for turned in turns:
            seen_by_two = np.stack([rays[a], rays[b][turned]], axis=1)
            located = intersect_rays(centers[None, [a, b]], seen_by_two)
            if _fit_grid(located, n)[1] > _IRREGULAR:
                continue
            score = sum(_match(grids, row, located, n) is not None for row in range(len(grids)))
            if best is None or score > best[0]:
                best = score, located
    return None if best is None else best[1]


def _fit_grid(located: np.ndarray, n: int) -> tuple[float, float]:
    """Spacing of corners (n * n, 3) as a grid of squares, and how far off one they are."""
    grid = np.stack([*np.meshgrid(np.arange(n), np.arange(n)), np.zeros((n, n))], axis=-1)
    if not np.isfinite(located).all():
        return 1.0, np.inf
    laid = lay_over(located, grid.reshape(-1, 3), np.zeros(n * n, int))
    return (laid.size, laid.misfit) if laid else (1.0, np.inf)


def _match(grids: Sightings, row: int, located: np.ndarray, n: int) -> np.ndarray | None:
    """Number on the face of each corner of a row's grid; None where it shows another face."""
    seen = grids.select(np.array([row])).in_cameras(located)[0]
    if (seen[:, 2] <= 0).any():
        return None
    places = seen[:, :2] / seen[:, 2:]
    away = np.linalg.norm(places[None] - grids.places[row][:, None], axis=-1)
    order = away.argmin(axis=1)
    steps = [
        np.linalg.norm(np.diff(places.reshape(n, n, 2), axis=axis), axis=-1) for axis in (0, 1)
    ]
    limit = _NEAR_CELLS * min(step.min() for step in steps)
    if len(set(order)) < n * n or away.min(axis=1).max() > limit:
        return None
    return order
