"""Photos without lens distortion: the dense workspace, and a photo at a time for later stages."""

import logging
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.files import temporary_folder
from cherrypicker.lens import Lenses, read_of_camera
from cherrypicker.mvs.workspace import Workspace
from cherrypicker.photos import JPEG_QUALITY, photo_error
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)


class UndistortedPhotos:
    """Photos of a sparse model without lens distortion, each made when it is asked for.

    The dense workspace's photos are large and go after the fusion; the few readers after it have
    the same pixels, less the JPEG's loss, from here. Of the photo files those are asked for that
    the model in the folder names.

    Raises
    ------
    StageError
        If the model cannot be read.
    """

    def __init__(self, model: str | os.PathLike, photos: Sequence[str | os.PathLike]) -> None:
        self.lenses = Lenses(model)
        self._files = {Path(photo).name: Path(photo) for photo in photos}

    def read(self, name: str, longest_px: int) -> np.ndarray:
        """Return a photo with a longer side of at most so many pixels, (height, width, 3) uint8.

        With -1 it has all pixels.

        Raises
        ------
        StageError
            If the photo is missing, unreadable or of another size than its camera.
        """
        photo, camera = self.read_stored(name), self.lenses.camera(name)
        options = pycolmap.UndistortCameraOptions()
        whole = pycolmap.undistort_camera(options, camera)
        K, size = whole.calibration_matrix(), (whole.width, whole.height)
        seen = self.lenses.undistorted(name, photo, K, size, cv2.INTER_LINEAR)
        options.max_image_size = longest_px
        pinhole = pycolmap.undistort_camera(options, camera)
        return cv2.resize(seen, (pinhole.width, pinhole.height), interpolation=cv2.INTER_AREA)

    def read_stored(self, name: str) -> np.ndarray:
        """Return a photo as it is stored, (height, width, 3) uint8; it raises as `read` does."""
        camera, path = self.lenses.camera(name), self._files.get(name)
        if path is None:
            raise photo_error(f"the photo {name} is missing")
        return read_of_camera(path, camera)


def undistort(
    model: str | os.PathLike,
    photos: Sequence[str | os.PathLike],
    workspace: str | os.PathLike,
    max_image_size: int,
    *,
    threads: int = 1,
) -> Poses:
    """Undistort the photos of a sparse model into a dense workspace, ``images`` and ``sparse``.

    The cameras are those of ``pycolmap.undistort_camera`` with default options, scaled down to a
    longest side of ``max_image_size`` px; their poses come back. All photos that the model in the
    folder names must be among the files, which lie in one folder.

    Raises
    ------
    StageError
        If a photo of the model is missing, unreadable or of another size than its camera.
    """
    workspace = Path(workspace)
    source = UndistortedPhotos(model, photos)
    for name in source.lenses.cameras:
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
