"""One raster a photo: how much every pixel looks like clear sky, thin wood or something solid.

A sky mask alone would cost twigs: a network calls some of them sky. So a pixel of the mask's sky
keeps how much a thin structure stands out there, darker or brighter than what surrounds it, and
nobody decides here from which contrast on that is wood: photos differ in noise and blur, and how
often wood and clear sky look like what is learnt from each of them
(`cherrypicker.evidence.witnesses`).
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from cherrypicker.mvs.clear_sky import MIN_CONTRAST, SkyMasks, thin_contrast, thin_window
from cherrypicker.mvs.workspace import view_of
from cherrypicker.photos import read_photo
from cherrypicker.poses import Poses
from cherrypicker.progress import Progress
from cherrypicker.sky.mask_files import write_mask

# Contrasts of a thin structure, grey levels of 255, at which the next level begins: a ladder of
# root-two steps from what sensor noise and JPEG leave of plain sky
LEVELS = (4, 6, 8, 12, 16, 24, 32)
# What a pixel shows: a level of the mask's sky, from 0 on; something solid; something thin, in
# whose pixels a place of wood finds more than in the solid; or what a user hides
SOLID, THIN, HIDDEN = len(LEVELS) + 1, len(LEVELS) + 2, 255
N_KINDS = THIN + 1
# From this level on a pixel of the mask's sky is no clear sky to who takes every pixel by itself.
# Stereo does, and leaves clear sky out: haze, clouds and plain sky pass; a twig and its blurred
# border do not, however wrong the mask
CLEAR_BELOW = LEVELS.index(MIN_CONTRAST) + 1


def make_raster(photo: np.ndarray, sky: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Say what every pixel of a photo shows.

    Parameters
    ----------
    photo : ndarray of shape (height, width, 3), uint8
    sky, hidden : ndarray of shape (height, width), bool
        Its mask, True = sky; what a user hides.

    Returns
    -------
    ndarray of shape (height, width), uint8
        Levels of sky below `SOLID`, `SOLID`, `THIN` or `HIDDEN`.
    """
    ladder = np.searchsorted(LEVELS, np.arange(256), side="right").astype(np.uint8)
    solid = (~sky & ~hidden).astype(np.uint8)
    thin = cv2.morphologyEx(solid, cv2.MORPH_TOPHAT, thin_window(photo.shape))
    raster = np.where(solid > 0, SOLID + thin, ladder[thin_contrast(photo)]).astype(np.uint8)
    raster[hidden] = HIDDEN
    return raster


def write_rasters(images: Path, poses: Poses, masks: SkyMasks, folder: Path) -> None:
    """Write what each undistorted photo in ``images`` shows, ``{stem}.png``, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    views = [view_of(poses, i) for i in range(len(poses))]
    with Progress(len(views), "photos asked for sky, thin and solid") as bar:
        for view in views:
            raster = make_raster(read_photo(images / view.name), *masks.both(view))
            write_mask(folder / f"{Path(view.name).stem}.png", raster)
            bar.step()
