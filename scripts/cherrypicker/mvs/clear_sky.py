"""What tells clear sky from twigs before it: a photo's thin structures, and its sky mask."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from cherrypicker.lens import PhotoLenses
from cherrypicker.mvs.workspace import View
from cherrypicker.sky.mask_files import read_masks

# Structures narrower than this share of the photo's longer side count as thin (guess)
THIN_SHARE = 0.0075
# Least contrast of a thin structure with its surroundings, grey levels of 255: above sensor noise
# and JPEG once smoothed, below a twig of one pixel (guess)
MIN_CONTRAST = 12
# Rows that go through the lens model at a time; bounds the memory
ROWS_AT_A_TIME = 64


def thin_contrast(photo: np.ndarray) -> np.ndarray:
    """Contrast of the thin structure at each pixel with what surrounds it.

    The larger of the black and the white top-hat of the smoothed photo, over its channels.

    Parameters
    ----------
    photo : ndarray of shape (height, width, 3), uint8

    Returns
    -------
    ndarray of shape (height, width), uint8
        Grey levels.
    """
    window = thin_window(photo.shape)
    smooth = cv2.GaussianBlur(photo, (3, 3), 0)
    dark = cv2.morphologyEx(smooth, cv2.MORPH_BLACKHAT, window)
    bright = cv2.morphologyEx(smooth, cv2.MORPH_TOPHAT, window)
    return np.maximum(dark, bright).max(axis=2)


def thin_window(shape: tuple[int, ...]) -> np.ndarray:
    """Return the window in which what is thin in a photo of a shape does not fit, uint8."""
    side = 2 * max(round(0.5 * THIN_SHARE * max(shape)), 2) + 1
    return np.ones((side, side), np.uint8)


class SkyMasks:
    """The sky masks of the photos as stored, seen through the undistorted cameras.

    They also hold what a user hides, which is neither sky nor anything else.

    Parameters
    ----------
    folder : path-like
        One mask per photo, ``{stem}.png``, in the pixels of the photo as stored.
    model : path-like
        Sparse model of the photos as stored, for the lenses.

    Raises
    ------
    StageError
        When the model is unreadable or lacks a photo; by `both`, when a mask is missing or of
        another size.
    """

    def __init__(
        self,
        folder: str | os.PathLike,
        model: str | os.PathLike,
        names: Sequence[str] | np.ndarray,
    ):
        self._folder = Path(folder)
        self._index = {str(name): i for i, name in enumerate(names)}
        self._lenses = PhotoLenses(model, names)
        self._maps: tuple[tuple, np.ndarray] | None = None

    def both(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """Return what is sky in a view and what a user hides, each (height, width) bool.

        Undistorted pixels; what lies outside the photo as stored is neither.
        """
        i = self._index[view.name]
        path = self._folder / f"{Path(view.name).stem}.png"
        sky, hidden = read_masks(path, self._lenses.shape(i))
        kinds = sky.astype(np.uint8) + 2 * hidden.astype(np.uint8)
        at = self._photo_pixels(i, view)
        seen = cv2.remap(kinds, at, None, cv2.INTER_NEAREST, borderValue=0)  # type: ignore[call-overload]
        return seen == 1, seen == 2

    def _photo_pixels(self, i: int, view: View) -> np.ndarray:
        """Pixel (x, y) of the photo as stored for each undistorted one, (height, width, 2)."""
        key = (self._lenses.key(i), view.K.tobytes(), view.width, view.height)
        if self._maps is None or self._maps[0] != key:
            at = np.empty((view.height, view.width, 2), dtype=np.float32)
            inverse = np.linalg.inv(view.K)
            x = np.arange(view.width) + 0.5
            for first in range(0, view.height, ROWS_AT_A_TIME):
                y = np.arange(first, min(first + ROWS_AT_A_TIME, view.height)) + 0.5
                pixels = np.stack([*map(np.ravel, np.meshgrid(x, y)), np.ones(len(x) * len(y))])
                photo = self._lenses.to_photo(i, (inverse @ pixels).T)
                # OpenCV counts from the centre of the first pixel
                at[first : first + len(y)] = photo.reshape(len(y), -1, 2) - 0.5
            self._maps = (key, at)
        return self._maps[1]
