"""The dense workspace: photos without lens distortion, beside the sparse model."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.lens import read_model
from cherrypicker.mvs.workspace import Workspace
from cherrypicker.photos import read_photo

logger = logging.getLogger(__name__)

# COLMAP's default recompresses at a quality that blurs twigs (guess)
JPEG_QUALITY = 96


def undistort(
    model: str | os.PathLike,
    photos: Sequence[str | os.PathLike],
    workspace: str | os.PathLike,
    max_image_size: int,
    *,
    threads: int = 1,
) -> dict:
    """Undistort the photos of a sparse model into a new dense workspace.

    The cameras are those of ``pycolmap.undistort_camera`` with default options, scaled down to
    ``max_image_size``. What the workspace held before is removed, depth maps included: they belong
    to other photos or cameras.

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
    dict
        ``max_image_size`` and, under ``photos``, name, width and height of each undistorted photo.

    Raises
    ------
    StageError
        If a photo of the model is missing, unreadable or of another size than its camera.
    """
    workspace = Path(workspace)
    reconstruction = read_model(model)
    folder = _photo_folder(reconstruction, photos)
    for part in ("images", "sparse", "stereo"):
        shutil.rmtree(workspace / part, ignore_errors=True)
    workspace.mkdir(parents=True, exist_ok=True)
    options = pycolmap.UndistortCameraOptions()
    options.max_image_size = max_image_size
    try:
        pycolmap.undistort_images(
            workspace,
            model,
            folder,
            undistort_options=options,
            jpeg_quality=JPEG_QUALITY,
            num_threads=threads,
        )
    except (RuntimeError, ValueError) as error:
        raise StageError(f"undistortion failed ({error})", file=folder) from error
    views = Workspace(workspace).views
    sizes = [{"name": view.name, "width": view.width, "height": view.height} for view in views]
    megapixels = sum(view.width * view.height for view in views) / 1e6
    logger.info("undistorted %d photos, %.1f megapixels", len(sizes), megapixels)
    return {"max_image_size": max_image_size, "photos": sizes}


def _photo_folder(
    reconstruction: pycolmap.Reconstruction, photos: Sequence[str | os.PathLike]
) -> Path:
    """Return the folder of the photos after a look at each one that the model names."""
    paths = {Path(photo).name: Path(photo) for photo in photos}
    for image in reconstruction.images.values():
        path = paths.get(image.name)
        if path is None:
            raise StageError(
                f"the sparse model names {image.name}, which is not among the photos",
                key="photos in trees.tsv",
            )
        height, width = read_photo(path).shape[:2]
        if (width, height) != (image.camera.width, image.camera.height):
            raise StageError(
                f"the photo is {width} x {height} px, its camera "
                f"{image.camera.width} x {image.camera.height} px",
                file=path,
                key="photos in trees.tsv",
            )
    return next(iter(paths.values())).parent
