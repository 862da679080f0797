"""From camera coordinates to the pixels of the photos as stored, lens distortion included."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

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
        for name, length_of in _RECORDS.items():
            path = Path(folder) / name
            if path.is_file():
                _check_promise(path.read_bytes(), length_of, path)
        return pycolmap.Reconstruction(os.fspath(folder))
    except (ValueError, RuntimeError, OSError, LookupError, MemoryError) as error:
        raise StageError(f"the sparse model cannot be read ({error})", file=folder) from error


def _check_promise(content: bytes, length_of: Callable[[bytes, int], int], path: Path) -> None:
    """Refuse a file that is shorter than its numbers say: COLMAP would take memory for all of them.

    Parameters
    ----------
    length_of : callable
        Returns the bytes of the record that begins at a place of the content.
    """
    try:
        (n_records,) = _COUNT.unpack_from(content)
        at = _COUNT.size
        for _ in range(n_records):
            at += length_of(content, at)
            if at > len(content):
                raise ValueError("a record ends beyond the file")
    except (struct.error, ValueError, LookupError) as error:
        raise StageError(f"the sparse model is cut short ({error})", file=path) from error


def _camera(content: bytes, at: int) -> int:
    model = int.from_bytes(content[at + 4 : at + 8], "little", signed=True)
    return 24 + 8 * len(pycolmap.Camera.create(1, pycolmap.CameraModelId(model), 1.0, 1, 1).params)


def _rig(content: bytes, at: int) -> int:
    n_sensors = struct.unpack_from("<I", content, at + 4)[0]
    length = 8 + (8 if n_sensors else 0)
    for _ in range(n_sensors - 1):
        length += 9 + (56 if content[at + length + 8] else 0)
    return length


def _frame(content: bytes, at: int) -> int:
    return 68 + 16 * struct.unpack_from("<I", content, at + 64)[0]


def _image(content: bytes, at: int) -> int:
    name_end = content.index(b"\0", at + 64) + 1
    return name_end - at + 8 + 24 * _COUNT.unpack_from(content, name_end)[0]


def _point(content: bytes, at: int) -> int:
    return 51 + 8 * _COUNT.unpack_from(content, at + 43)[0]


_COUNT = struct.Struct("<Q")
# Files of a model and the lengths of their records (COLMAP, doc/format.rst and
# src/colmap/scene/reconstruction_io_binary.cc)
_RECORDS = {
    "cameras.bin": _camera,
    "rigs.bin": _rig,
    "frames.bin": _frame,
    "images.bin": _image,
    "points3D.bin": _point,
}


def stored_pixels(camera: pycolmap.Camera, K: np.ndarray, width: int, height: int) -> np.ndarray:
    """Where each pixel of an undistorted photo lies in the photo as stored, for OpenCV.

    Parameters
    ----------
    camera : pycolmap.Camera
        Of the photo as stored.
    K, width, height
        Of the undistorted one.

    Returns
    -------
    ndarray of shape (height, width, 2), float32
        Pixels (x, y), (0, 0) in the middle of the first.
    """
    at = np.empty((height, width, 2), dtype=np.float32)
    ray = np.ones((width, 3))
    ray[:, 0] = (np.arange(width) + 0.5 - K[0, 2]) / K[0, 0]
    for row, y in enumerate((np.arange(height) + 0.5 - K[1, 2]) / K[1, 1]):
        ray[:, 1] = y
        at[row] = np.asarray(camera.img_from_cam(ray)) - 0.5
    return at


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

    def to_photo(self, i: int, in_camera: np.ndarray) -> np.ndarray:
        """Project camera coordinates (n, 3), z > 0, to pixels (n, 2), centres at (0.5, 0.5)."""
        points = np.ascontiguousarray(in_camera, dtype=np.float64)
        return np.asarray(self._cameras[i].img_from_cam(points)).reshape(-1, 2)
