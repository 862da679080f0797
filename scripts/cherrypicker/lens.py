"""From camera coordinates to the pixels of the photos as stored, lens distortion included."""

import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.photos import photo_error, read_photo


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

    `length_of` tells the bytes of the record that begins at a place of the content.
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
    model = pycolmap.CameraModelId(struct.unpack_from("<i", content, at + 4)[0])
    return 24 + 8 * len(pycolmap.Camera.create_from_model_id(1, model, 1.0, 1, 1).params)


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


def read_of_camera(path: str | os.PathLike, camera: pycolmap.Camera) -> np.ndarray:
    """Read a photo as it is stored, (height, width, 3) uint8.

    Raises
    ------
    StageError
        If it is missing, unreadable or of another size than its camera.
    """
    photo = read_photo(path)
    height, width = photo.shape[:2]
    if (width, height) != (camera.width, camera.height):
        size = f"{camera.width} x {camera.height}"
        raise photo_error(f"the photo is {width} x {height} px, its camera {size} px", path)
    return photo


class Lenses:
    """The cameras of the photos as stored, by the photo's name, from the folder of their model.

    Raises
    ------
    StageError
        If the model cannot be read; by the methods, if it lacks the photo.
    """

    def __init__(self, model: str | os.PathLike) -> None:
        self._file, self._model = model, read_model(model)
        self.cameras = {image.name: image.camera for image in self._model.images.values()}
        # Of the cameras last asked for: most scans have one
        self._last: tuple[tuple, Any] = ((), None)

    def camera(self, name: str) -> pycolmap.Camera:
        """Return a photo's camera."""
        if name not in self.cameras:
            raise photo_error(f"photo {name} is not in the sparse model", self._file)
        return self.cameras[name]

    def to_photo(self, name: str, in_camera: np.ndarray) -> np.ndarray:
        """Project camera coordinates (n, 3), z > 0, to pixels (n, 2), centres at (0.5, 0.5)."""
        points = np.ascontiguousarray(in_camera, dtype=np.float64)
        return np.asarray(self.camera(name).img_from_cam(points)).reshape(-1, 2)

    def undistorted(
        self, name: str, photo: np.ndarray, K: np.ndarray, size: tuple[int, int], way: int
    ) -> np.ndarray:
        """Show what belongs to a photo as stored, (height, width, ...), by a pinhole.

        Parameters
        ----------
        K, size
            The pinhole's intrinsics, pixel centres at (0.5, 0.5), and its width and height, px.
        way : int
            How OpenCV interpolates; what lies outside the photo is 0.
        """
        camera, (width, height) = self.camera(name), size
        key = (camera.camera_id, K.tobytes(), *size, way)
        if self._last[0] != key:
            at = np.empty((height, width, 2), dtype=np.float32)
            ray = np.ones((width, 3))
            ray[:, 0] = (np.arange(width) + 0.5 - K[0, 2]) / K[0, 0]
            for row, y in enumerate((np.arange(height) + 0.5 - K[1, 2]) / K[1, 1]):
                ray[:, 1] = y
                at[row] = np.asarray(camera.img_from_cam(ray)) - 0.5
            whole = way == cv2.INTER_LINEAR  # numbers, which are faster
            x, y = at[..., 0], at[..., 1]
            self._last = key, cv2.convertMaps(x, y, cv2.CV_16SC2) if whole else (x, y)
        first, second = self._last[1]
        return np.asarray(cv2.remap(photo, first, second, way, borderValue=0))
