"""Photos without lens distortion: the dense workspace, and a photo at a time for later stages."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.files import temporary_folder
from cherrypicker.lens import read_model, stored_pixels
from cherrypicker.mvs.workspace import Workspace
from cherrypicker.photos import read_photo
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)

# COLMAP's default recompresses at a quality that blurs twigs (guess)
JPEG_QUALITY = 96


class UndistortedPhotos:
    """Photos of a sparse model without lens distortion, each made when it is asked for.

    The dense workspace's photos are large and go after the fusion; the few readers after it have
    the same pixels, less the JPEG's loss, from here.

    Parameters
    ----------
    model : path-like
        Folder of the sparse model.
    photos : sequence of path-like
        Photo files; those that the model names are asked for.

    Raises
    ------
    StageError
        If the model cannot be read.
    """

    def __init__(self, model: str | os.PathLike, photos: Sequence[str | os.PathLike]) -> None:
        self._model = read_model(model)
        self.cameras = {image.name: image.camera for image in self._model.images.values()}
        # Of the camera that was last asked for: most scans have one
        self._from: tuple[int, Any, Any] | None = None
        self._files = {Path(photo).name: Path(photo) for photo in photos}

    def read(self, name: str, longest_px: int) -> np.ndarray:
        """Return a photo with a longer side of at most so many pixels, (height, width, 3) uint8.

        Raises
        ------
        StageError
            If the photo is missing, unreadable or of another size than its camera.
        """
        photo, camera = self.read_stored(name)
        if self._from is None or self._from[0] != camera.camera_id:
            pinhole = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera)
            at = stored_pixels(camera, pinhole.calibration_matrix(), pinhole.width, pinhole.height)
            maps = cv2.convertMaps(at[..., 0], at[..., 1], cv2.CV_16SC2)
            self._from = camera.camera_id, maps[0], maps[1]
        whole = cv2.remap(photo, self._from[1], self._from[2], cv2.INTER_LINEAR)
        options = pycolmap.UndistortCameraOptions()
        options.max_image_size = longest_px
        pinhole = pycolmap.undistort_camera(options, camera)
        return cv2.resize(whole, (pinhole.width, pinhole.height), interpolation=cv2.INTER_AREA)

    def read_stored(self, name: str) -> tuple[np.ndarray, pycolmap.Camera]:
        """Return a photo as it is stored, (height, width, 3) uint8, and its camera.

        Raises
        ------
        StageError
            As `read`.
        """
        camera, path = self.cameras.get(name), self._files.get(name)
        if camera is None or path is None:
            raise StageError(
                f"{name} is not among the photos of the sparse model", key="photos in trees.tsv"
            )
        photo = read_photo(path)
        height, width = photo.shape[:2]
        if (width, height) != (camera.width, camera.height):
            raise StageError(
                f"the photo is {width} x {height} px, its camera {camera.width} x "
                f"{camera.height} px",
                file=path,
                key="photos in trees.tsv",
            )
        return photo, camera


def undistort(
    model: str | os.PathLike,
    photos: Sequence[str | os.PathLike],
    workspace: str | os.PathLike,
    max_image_size: int,
    *,
    threads: int = 1,
) -> Poses:
    """Undistort the photos of a sparse model into a dense workspace, ``images`` and ``sparse``.

    The cameras are those of ``pycolmap.undistort_camera`` with default options, scaled down to
    ``max_image_size``.

    Parameters
    ----------
    model : path-like
        Folder of the sparse model.
    photos : sequence of path-like
        Photo files; all that the model names must be among them, in one folder.
    max_image_size : int
        Longest side of an undistorted photo, px.

    Returns
    -------
    Poses
        Of the undistorted photos.

    Raises
    ------
    StageError
        If a photo of the model is missing, unreadable or of another size than its camera.
    """
    workspace = Path(workspace)
    source = UndistortedPhotos(model, photos)
    for name in source.cameras:
        source.read_stored(name)
    folder = Path(photos[0]).parent
    options = pycolmap.UndistortCameraOptions()
    options.max_image_size = max_image_size
    with temporary_folder(workspace, ".undistorted.") as made:
        try:
            pycolmap.undistort_images(
                made,
                model,
                folder,
                undistort_options=options,
                jpeg_quality=JPEG_QUALITY,
                num_threads=threads,
            )
        except (RuntimeError, ValueError) as error:
            raise StageError(f"undistortion failed ({error})", file=folder) from error
        for part in ("images", "sparse"):
            shutil.rmtree(workspace / part, ignore_errors=True)
            (made / part).rename(workspace / part)
    poses = Workspace(workspace).poses
    megapixels = float((poses.width * poses.height).sum()) / 1e6
    logger.info("undistorted %d photos, %.1f megapixels", len(poses), megapixels)
    return poses
