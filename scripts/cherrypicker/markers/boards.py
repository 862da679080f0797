"""Boards of known layout in photos: ChArUco boards, and the faces of a checker cube.

A ChArUco board's corners are numbered by its markers. A cube's are not: a face is a grid of corners
that looks the same from two sides, and three faces look alike. Two photos' grids are the same face
if their corners, located from both, are a regular grid; the pair that most other photos agree with
names the corners in all of them, as `cherrypicker.markers.geometry` finds a marker.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import combinations
from typing import Any

import cv2
import numpy as np

from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.markers.detection import marker_dictionary
from cherrypicker.markers.geometry import intersect_rays
from cherrypicker.markers.layouts import Sightings, scale_and_misfit

_MAX_FACES = 3  # of a cube that one photo shows
# Guesses. Grids are sought in photos reduced to this longer side, corners refined in the full ones
_SEARCH_SIDE_PX = 2400
_MAX_PAIRS, _MIN_PARALLAX_DEG = 600, 3.0
_IRREGULAR = 0.1  # what corners located from two photos may be off a grid, of its extent
_NEAR_CELLS = 0.25  # of a grid's spacing in a photo: a corner this near is the same
_REFINE_ROUNDS, _REFINED_PX = 30, 0.001  # cv2.cornerSubPix: steps at most, and what ends them


@dataclass(frozen=True)
class Found:
    """Corners of one board, or of one face, in a photo."""

    points: np.ndarray  # (n,) int: numbers on the board
    corners: np.ndarray  # (n, 2): px, pixel centres at (0.5, 0.5)


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


def charuco_finder(values: Any) -> Callable[[np.ndarray], list[Found]]:
    """Return what finds a ChArUco board in a grey photo."""

    def find(grey: np.ndarray) -> list[Found]:
        # A detector for each photo: OpenCV's own is not made for threads.
        detector = cv2.aruco.CharucoDetector(charuco_board(values))
        corners, ids, _, _ = detector.detectBoard(grey)
        if ids is None or len(ids) < 4:
            return []
        return [Found(np.ravel(ids).astype(int), np.reshape(corners, (-1, 2)).astype(float) + 0.5)]

    return find


def cube_finder(values: Any) -> Callable[[np.ndarray], list[Found]]:
    """Return what finds the faces of a checker cube in a grey photo."""
    n = values["cells"] - 1

    def find(grey: np.ndarray) -> list[Found]:
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
            places = _refined(grey, (places.reshape(-1, 2) + 0.5) / factor, n)
            found.append(Found(np.arange(n * n), places))
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
    found: list[list[Found]], cameras: list, cam_from_world: np.ndarray
) -> list[Sightings]:
    """Each board or face of each photo as sightings on undistorted coordinates."""
    boards = []
    for photo, (each, camera) in enumerate(zip(found, cameras)):
        focal = float(np.mean([camera.focal_length_x, camera.focal_length_y]))
        for board in each:
            places = np.asarray(camera.cam_from_img(np.ascontiguousarray(board.corners)), float)
            seen = np.isfinite(places).all(axis=1)
            n = int(seen.sum())
            boards.append(
                Sightings(
                    photos=np.full(n, photo),
                    cam_from_world=np.repeat(cam_from_world[photo][None], n, axis=0),
                    focal=np.full(n, focal),
                    points=board.points[seen],
                    places=places[seen],
                )
            )
    return boards


def joined(parts: list[Sightings]) -> Sightings:
    """Several sightings as one."""
    names = [each.name for each in fields(Sightings)]
    return Sightings(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    )


def name_faces(grids: list[Sightings], n: int, *, min_photos: int, seed: int) -> list[Sightings]:
    """Tell which grids of corners are the same face of a cube, and number their corners alike.

    Parameters
    ----------
    grids : list of Sightings
        Grids of n x n corners, row by row, of all photos.
    n : int
        Inner corners along an edge.
    min_photos : int
        Photos that must show a face.

    Returns
    -------
    list of Sightings
        The faces, the best seen first, with points numbered by face and corner; those farther from
        the first than its cube reaches are other boards and left out.
    """
    faces: list[Sightings] = []
    first = None
    while len(faces) < 6:
        best = _best_face(grids, n, seed)
        if best is None or len({int(grid.photos[0]) for _, grid in best[1]}) < min_photos:
            break
        located, members = best
        names = {index for index, _ in members}
        grids = [grid for index, grid in enumerate(grids) if index not in names]
        middle, (cells, _) = located.mean(axis=0), _fit_grid(located, n)
        spacing = 1 / cells
        first = first or (middle, spacing)
        # Centres of two faces of a cube are an edge apart at most, n + 1 cells.
        is_near = np.linalg.norm(middle - first[0]) < 1.2 * (n + 1) * first[1]
        if is_near and abs(spacing / first[1] - 1) < _IRREGULAR:
            face = joined([grid for _, grid in members])
            face.points = face.points + len(faces) * n * n
            faces.append(face)
    return faces


def _best_face(
    grids: list[Sightings], n: int, seed: int
) -> tuple[np.ndarray, list[tuple[int, Sightings]]] | None:
    """Corners (n * n, 3) of the face that most photos agree on, and its grids, numbered alike."""
    pairs = np.array(
        [
            (a, b)
            for a, b in combinations(range(len(grids)), 2)
            if grids[a].photos[0] != grids[b].photos[0]
        ]
    ).reshape(-1, 2)
    best: tuple[float, np.ndarray] | None = None
    for a, b in thin_randomly(pairs, _MAX_PAIRS, seed):
        one, other = grids[a], grids[b]
        cosine = float(one.rays.mean(axis=0) @ other.rays.mean(axis=0))
        if cosine > np.cos(np.radians(_MIN_PARALLAX_DEG)):
            continue
        for turned in _turns(n):
            origins = np.stack([one.centers, other.centers], axis=1)
            rays = np.stack([one.rays, other.rays[turned]], axis=1)
            located = intersect_rays(origins, rays)
            if _fit_grid(located, n)[1] > _IRREGULAR:
                continue
            score = sum(_match(grid, located, n) is not None for grid in grids)
            if best is None or score > best[0]:
                best = score, located
    if best is None:
        return None
    members = []
    for index, grid in enumerate(grids):
        order = _match(grid, best[1], n)
        if order is not None:
            members.append((index, replace(grid, points=order)))
    return best[1], members


def _turns(n: int) -> list[np.ndarray]:
    """The eight orders in which the same grid of n x n corners can be listed."""
    grid = np.arange(n * n).reshape(n, n)
    turned = [np.rot90(flipped, k) for flipped in (grid, grid.T) for k in range(4)]
    return [each.ravel() for each in turned]


def _fit_grid(located: np.ndarray, n: int) -> tuple[float, float]:
    """Cells a unit of corners (n * n, 3) as a grid of squares, and how far off one they are."""
    grid = np.stack([*np.meshgrid(np.arange(n), np.arange(n)), np.zeros((n, n))], axis=-1)
    if not np.isfinite(located).all():
        return 1.0, np.inf
    fitted = scale_and_misfit(located, grid.reshape(-1, 3), np.zeros(n * n, int))
    return fitted or (1.0, np.inf)


def _match(grid: Sightings, located: np.ndarray, n: int) -> np.ndarray | None:
    """Number on the face of each corner of a grid; None where it shows another face."""
    pose = grid.cam_from_world[0]
    seen = located @ pose[:, :3].T + pose[:, 3]
    if (seen[:, 2] <= 0).any():
        return None
    places = seen[:, :2] / seen[:, 2:]
    away = np.linalg.norm(places[None] - grid.places[:, None], axis=-1)
    order = away.argmin(axis=1)
    steps = [
        np.linalg.norm(np.diff(places.reshape(n, n, 2), axis=axis), axis=-1) for axis in (0, 1)
    ]
    limit = _NEAR_CELLS * min(step.min() for step in steps)
    if len(set(order)) < n * n or away.min(axis=1).max() > limit:
        return None
    return order
