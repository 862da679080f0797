"""From camera coordinates to the pixels of the photos as stored, lens distortion included."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
import pycolmap

from cherrypicker.errors import StageError


def read_model(folder: str | os.PathLike) -> pycolmap.Reconstruction:
    """Read a sparse model.

    Raises
    ------
    StageError
        If it is missing or broken.
    """
    try:
        return pycolmap.Reconstruction(os.fspath(folder))
    except (ValueError, RuntimeError, OSError) as error:
        raise StageError(f"the sparse model cannot be read ({error})", file=folder) from error


class PhotoLenses:
    """The distorted cameras of a sparse model, by photo.

    Parameters
    ----------
    model : path-like
        Folder of a COLMAP model.
    names : sequence of str
        Photo names; index ``i`` of the methods is a position in this list.

    Raises
    ------
    StageError
        When the model is unreadable or lacks one of the photos.
    """

    def __init__(self, model: str | os.PathLike, names: Sequence[str] | np.ndarray) -> None:
        reconstruction = read_model(model)
        cameras = {image.name: image.camera_id for image in reconstruction.images.values()}
        missing = [str(name) for name in names if str(name) not in cameras]
        if missing:
            raise StageError(f"photo {missing[0]} is not in the sparse model", file=model)
        self._cameras = [reconstruction.cameras[cameras[str(name)]] for name in names]

    def shape(self, i: int) -> tuple[int, int]:
        """Height and width of photo ``i`` as stored."""
        return int(self._cameras[i].height), int(self._cameras[i].width)

    def key(self, i: int) -> tuple:
        """What tells the camera of photo ``i`` from others: model, size and parameters."""
        camera = self._cameras[i]
        return camera.model.name, *self.shape(i), *map(float, camera.params)

    def to_photo(self, i: int, in_camera: np.ndarray) -> np.ndarray:
        """Project camera coordinates (n, 3), z > 0, to pixels (n, 2), centres at (0.5, 0.5)."""
        points = np.ascontiguousarray(in_camera, dtype=np.float64)
        return np.asarray(self._cameras[i].img_from_cam(points)).reshape(-1, 2)
