"""One raster a photo: how much every pixel looks like clear sky, thin wood or something solid.

A sky mask alone would cost twigs: a network calls some of them sky. So a pixel of the mask's sky
keeps how much a thin structure stands out there, darker or brighter than what surrounds it, and
nobody decides here from which contrast on that is wood: photos differ in noise and blur, and how
often wood and clear sky look like what is learnt from each of them
(`cherrypicker.evidence.witnesses`).
"""

import os
from pathlib import Path

import cv2
import numpy as np

from cherrypicker.lens import Lenses
from cherrypicker.photos import read_photo
from cherrypicker.poses import Poses, View
from cherrypicker.progress import Progress
from cherrypicker.sky.mask_files import read_masks, write_mask

# Structures narrower than this share of the photo's longer side count as thin (guess)
THIN_SHARE = 0.0075
# Contrasts of a thin structure, grey levels of 255, at which the next level begins: a ladder of
# root-two steps from what sensor noise and JPEG leave of plain sky
LEVELS = (4, 6, 8, 12, 16, 24, 32)
# What a pixel shows: a level of the mask's sky, from 0 on; something solid; something thin, in
# whose pixels a place of wood finds more than in the solid; or what a user hides
SOLID, THIN, HIDDEN = len(LEVELS) + 1, len(LEVELS) + 2, 255
N_KINDS = THIN + 1
# From this level on, 12 grey levels, a pixel of the mask's sky is no clear sky to who takes every
# pixel by itself (guess: above sensor noise and JPEG once smoothed, below a twig of one pixel).
# Stereo does, and leaves clear sky out: haze, clouds and plain sky pass; a twig and its blurred
# border do not, however wrong the mask
CLEAR_BELOW = LEVELS.index(12) + 1


def make_raster(photo: np.ndarray, sky: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Say what every pixel of a photo (height, width, 3), uint8, shows.

    How much something thin stands out before the sky is the larger of the black and the white
    top-hat of the smoothed photo, over its channels. What is sky and what a user hides is told by
    masks (height, width), bool. The raster, (height, width) uint8, holds levels of sky below
    `SOLID`, `SOLID`, `THIN` or `HIDDEN`.
    """
    side = 2 * max(round(0.5 * THIN_SHARE * max(photo.shape)), 2) + 1
    window = np.ones((side, side), np.uint8)  # in which what is thin does not fit
    smooth = cv2.GaussianBlur(photo, (3, 3), 0)
    dark = cv2.morphologyEx(smooth, cv2.MORPH_BLACKHAT, window)
    bright = cv2.morphologyEx(smooth, cv2.MORPH_TOPHAT, window)
    contrast = np.maximum(dark, bright).max(axis=2)
    ladder = np.searchsorted(LEVELS, np.arange(256), side="right").astype(np.uint8)
    solid = (~sky & ~hidden).astype(np.uint8)
    thin = cv2.morphologyEx(solid, cv2.MORPH_TOPHAT, window)
    raster = np.where(solid > 0, SOLID + thin, ladder[contrast]).astype(np.uint8)
    raster[hidden] = HIDDEN
    return raster


class SkyMasks:
    """The sky masks of the photos as stored, seen through the undistorted cameras.

    They also hold what a user hides, which is neither sky nor anything else. In their folder lies
    one mask per photo, ``{stem}.png``, in the pixels of the photo as stored, of which the sparse
    model knows the lenses.

    Raises
    ------
    StageError
        When the model is unreadable; by `both`, when it lacks the photo, or when a mask is missing
        or of another size.
    """

    def __init__(self, folder: str | os.PathLike, model: str | os.PathLike):
        self._folder, self._lenses = Path(folder), Lenses(model)

    def both(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """Return what is sky in a view and what a user hides, each (height, width) bool.

        Undistorted pixels; what lies outside the photo as stored is neither.
        """
        camera = self._lenses.camera(view.name)
        path = self._folder / f"{Path(view.name).stem}.png"
        sky, hidden = read_masks(path, (camera.height, camera.width))
        kinds = sky.astype(np.uint8) + 2 * hidden.astype(np.uint8)
        size = view.width, view.height
        seen = self._lenses.undistorted(view.name, kinds, view.K, size, cv2.INTER_NEAREST)
        return seen == 1, seen == 2


def write_rasters(images: Path, poses: Poses, masks: SkyMasks, folder: Path) -> None:
    """Write what each undistorted photo in ``images`` shows, ``{stem}.png``, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with Progress(len(poses), "photos asked for sky, thin and solid") as bar:
        for view in poses:
            raster = make_raster(read_photo(images / view.name), *masks.both(view))
            write_mask(folder / f"{Path(view.name).stem}.png", raster)
            bar.step()
