"""Frames of a video that stand for photos: far enough apart, and each the sharpest around.

Corners of a frame are followed to the next ones (Lucas and Kanade). While they have moved by less
than half a step, a share of the picture, all frames show one place, and the sharpest of them is
taken; from there it is half a step to where the next place begins. Who stands still gives one
photo, who walks fast gives no gaps.
"""

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np

from cherrypicker.intake.stills import shrunk
from cherrypicker.photos import photo_error

logger = logging.getLogger(__name__)

STEP_KEY = "photos.video_step"
# Longer side at which corners are followed and sharpness is measured, px: with 320 and 1280 the
# same frames of five films are taken, but for one of 142
LOOK_PX = 640
# A corner counts that is followed there and back to within so many px, as in OpenCV's lk_track.py
BACK_PX = 1.0
# Frames that a header may promise and the film lack: encoders leave the last ones out
FEW_FRAMES_SHARE = 0.05
# cv2's rotation of a film's frames to be upright, degrees clockwise, as EXIF orientations
_ORIENTATION_OF_DEGREES = {0: 1, 90: 6, 180: 3, 270: 8}


class Frame:
    """A frame of a video, counted from 0; to be looked at it is grey and small enough."""

    def __init__(self, number: int, picture: np.ndarray) -> None:
        self.number, self._picture = number, picture  # BGR, as OpenCV reads it
        grey = cv2.cvtColor(shrunk(picture, LOOK_PX), cv2.COLOR_BGR2GRAY)
        self.grey = np.asarray(grey, np.uint8)
        # The variance of the Laplacian: what a frame shows matters too, but those of one step show
        # the same
        self.sharpness = float(cv2.Laplacian(self.grey, cv2.CV_32F).var())

    @property
    def pixels(self) -> np.ndarray:
        """The picture, (height, width, 3) uint8, RGB, the sensor's grid."""
        return self._picture[:, :, ::-1].copy()


@dataclass(frozen=True)
class FilmHeader:
    """What the header of a video says."""

    width: int
    height: int
    n_frames: int  # 0 where it does not say
    per_second: float
    orientation: int  # as EXIF's


def film_header(path: str | os.PathLike) -> FilmHeader:
    """Read the header of a video.

    Raises
    ------
    StageError
        If it does not open.
    """
    with _opened(path) as film:
        value = {
            name: float(np.nan_to_num(film.get(getattr(cv2, f"CAP_PROP_{name}"))))
            for name in ("FRAME_WIDTH", "FRAME_HEIGHT", "FRAME_COUNT", "FPS", "ORIENTATION_META")
        }
    return FilmHeader(
        width=int(value["FRAME_WIDTH"]),
        height=int(value["FRAME_HEIGHT"]),
        n_frames=max(int(value["FRAME_COUNT"]), 0),
        per_second=max(value["FPS"], 0.0),
        orientation=_ORIENTATION_OF_DEGREES.get(round(value["ORIENTATION_META"]) % 360, 1),
    )


def choose_frames(path: str | os.PathLike, step: float) -> Iterator[Frame]:
    """Yield the frames of a video that stand for photos, in their order.

    From one to the next the picture moves by a `step`, a share of its longer side.

    Raises
    ------
    StageError
        If the video does not open or holds no frame. One that breaks off gives what comes before,
        with a warning.
    """
    n_promised, n_read = film_header(path).n_frames, 0
    corners: _Corners | None = None  # of where a place, or the way to the next, begins
    best: Frame | None = None  # the sharpest frame of the place at hand; none on the way
    with _opened(path) as film:
        while (taken := film.read())[0]:
            here = Frame(n_read, taken[1])
            n_read += 1
            has_left = corners is None or corners.moved(here.grey) >= 0.5 * step
            if best and has_left:
                yield best
                corners, best = _Corners(best.grey), None
                has_left = corners.moved(here.grey) >= 0.5 * step
            elif best and here.sharpness > best.sharpness:
                best = here
            if has_left:
                corners = _Corners(here.grey)
                # A black frame is no place: nothing in it could be followed
                best = here if corners.count else None
    if not n_read:
        raise photo_error("the video holds no frame", path)
    if n_read < (1.0 - FEW_FRAMES_SHARE) * n_promised - 1:
        logger.warning(
            "%s breaks off after %d of %d frames: what comes before is used",
            *(os.path.basename(path), n_read, n_promised),
        )
    if best:
        yield best


@contextmanager
def _opened(path: str | os.PathLike) -> Iterator[cv2.VideoCapture]:
    film = cv2.VideoCapture(os.fspath(path), cv2.CAP_FFMPEG)
    if not film.isOpened():
        raise photo_error("the video cannot be opened", path)
    film.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    try:
        yield film
    finally:
        film.release()


class _Corners:
    """Corners of a frame, followed from frame to frame."""

    def __init__(self, grey: np.ndarray) -> None:
        # As in OpenCV's example
        corners = cv2.goodFeaturesToTrack(grey, maxCorners=300, qualityLevel=0.01, minDistance=7)
        self._start = np.empty((0, 1, 2), np.float32) if corners is None else corners
        self._now, self._last, self.count = self._start, grey, len(self._start)

    def moved(self, grey: np.ndarray) -> float:
        """How far half of them are from where they began, a share of the longer side.

        Those that are lost are infinitely far.
        """
        if len(self._now):
            # To the next frame, and back to where they were
            there, found, _ = cv2.calcOpticalFlowPyrLK(self._last, grey, self._now, None)  # type: ignore[call-overload]
            again, back, _ = cv2.calcOpticalFlowPyrLK(grey, self._last, there, None)  # type: ignore[call-overload]
            off = np.linalg.norm((again - self._now).reshape(-1, 2), axis=1)
            flat = there.reshape(-1, 2)
            kept = (flat >= 0).all(axis=1) & (flat < grey.shape[::-1]).all(axis=1)
            kept &= (found.ravel() > 0) & (back.ravel() > 0) & (off <= BACK_PX)
            self._start, self._now = self._start[kept], there[kept]
        self._last = grey
        away = np.full(max(self.count, 1), np.inf)
        away[: len(self._now)] = np.linalg.norm(self._now - self._start, axis=2)[:, 0]
        return float(np.median(away)) / max(grey.shape)
