"""COLMAP's dense workspace: undistorted cameras and photos, depth and normal maps.

A map file is the text ``width&height&channels&`` followed by little-endian float32, one channel
after the other, rows from the top, as ``pycolmap.DepthMap`` and ``pycolmap.NormalMap`` write it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.poses import Poses, project

_HEADER_BYTES = 64


@dataclass(frozen=True)
class View:
    """An undistorted photo with its camera.

    Attributes
    ----------
    image_id : int
        COLMAP's id.
    name : str
        File name below ``images/``.
    K : ndarray of shape (3, 3), float64
        Pinhole intrinsics, px, pixel centres at (0.5, 0.5).
    R, t : ndarray of shape (3, 3) and (3,), float64
        Camera from world.
    width, height : int
        Size of the undistorted photo, px.
    """

    image_id: int
    name: str
    K: np.ndarray
    R: np.ndarray
    t: np.ndarray
    width: int
    height: int

    @property
    def center(self) -> np.ndarray:
        """Camera centre in the world, (3,)."""
        return -self.R.T @ self.t

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pixel coordinates (n, 2) and depth (n,) of points (n, 3)."""
        return project(points, self.R, self.t, self.K)


class Workspace:
    """Paths and cameras of a dense workspace.

    Parameters
    ----------
    folder : path-like
        The workspace, as ``pycolmap.undistort_images`` leaves it.

    Raises
    ------
    StageError
        If the workspace has no readable sparse model or a camera that is no pinhole.
    """

    def __init__(self, folder: str | os.PathLike):
        self.folder = Path(folder)
        try:
            self.model = pycolmap.Reconstruction(self.folder / "sparse")
        except (ValueError, RuntimeError, OSError) as error:
            raise StageError(f"no sparse model ({error})", file=self.folder / "sparse") from error
        images = sorted(self.model.images.values(), key=lambda image: image.name)
        self.views = [_view(image, self.folder) for image in images if image.has_pose]
        if len(self.views) < 2:
            raise StageError(
                f"dense stereo needs two registered photos, got {len(self.views)}",
                file=self.folder / "sparse",
                key="sfm.min_registered_fraction",
            )

    @property
    def poses(self) -> Poses:
        """The views' poses, one a view."""
        return Poses(
            names=np.array([view.name for view in self.views]),
            cam_from_world=np.array([np.column_stack([view.R, view.t]) for view in self.views]),
            K=np.array([view.K for view in self.views]),
            width=np.array([view.width for view in self.views]),
            height=np.array([view.height for view in self.views]),
        )

    def photo_path(self, view: View) -> Path:
        """Return the undistorted photo's path."""
        return self.folder / "images" / view.name

    def depth_path(self, view: View, kind: str) -> Path:
        """Return the path of a depth map, ``kind`` being "photometric" or "geometric"."""
        return self.folder / "stereo" / "depth_maps" / f"{view.name}.{kind}.bin"

    def normal_path(self, view: View, kind: str) -> Path:
        """Return the path of a normal map, ``kind`` being "photometric" or "geometric"."""
        return self.folder / "stereo" / "normal_maps" / f"{view.name}.{kind}.bin"

    def has_maps(self, view: View, kind: str) -> bool:
        """Whether depth and normal map are there, whole and of the photo's size."""
        size = (view.width, view.height)
        return is_valid_map(self.depth_path(view, kind), size, 1) and is_valid_map(
            self.normal_path(view, kind), size, 3
        )

    def read_depth(self, view: View, kind: str) -> np.ndarray:
        """Read a depth map, (height, width) float32, 0 where unknown."""
        return self._checked(self.depth_path(view, kind), view)

    def read_normals(self, view: View, kind: str) -> np.ndarray:
        """Read a normal map, (height, width, 3) float32, camera frame, towards the camera."""
        return self._checked(self.normal_path(view, kind), view)

    def write_maps(self, view: View, kind: str, depth: np.ndarray, normals: np.ndarray) -> None:
        """Write depth (height, width) and normals (height, width, 3), each atomically."""
        write_map(self.normal_path(view, kind), normals)
        write_map(self.depth_path(view, kind), depth)

    def remove_maps(self, view: View) -> None:
        """Remove a photo's maps of both kinds."""
        for kind in ("photometric", "geometric"):
            self.depth_path(view, kind).unlink(missing_ok=True)
            self.normal_path(view, kind).unlink(missing_ok=True)

    def write_fusion_config(self) -> None:
        """Write ``stereo/fusion.cfg``, the photos that COLMAP's fusion goes through."""
        path = self.folder / "stereo" / "fusion.cfg"
        with atomic_path(path) as temporary:
            temporary.write_text("".join(f"{view.name}\n" for view in self.views), encoding="utf-8")

    @staticmethod
    def _checked(path: Path, view: View) -> np.ndarray:
        array = read_map(path)
        if array.shape[:2] != (view.height, view.width):
            raise StageError(
                f"the map is {array.shape[1]} x {array.shape[0]} px, "
                f"the photo {view.width} x {view.height} px",
                file=path,
            )
        return array


def _view(image: pycolmap.Image, folder: Path) -> View:
    camera: pycolmap.Camera = image.camera  # type: ignore[assignment]  # a read model has it
    if camera.model.name not in ("PINHOLE", "SIMPLE_PINHOLE"):
        raise StageError(
            f"camera of {image.name} is {camera.model.name}, not an undistorted pinhole",
            file=folder / "sparse",
        )
    pose = image.cam_from_world().matrix()
    return View(
        image_id=image.image_id,
        name=image.name,
        K=camera.calibration_matrix(),
        R=pose[:, :3],
        t=pose[:, 3],
        width=int(camera.width),
        height=int(camera.height),
    )


def view_of(poses: Poses, i: int) -> View:
    """Return photo ``i`` of some poses as a view; its number stands for COLMAP's id."""
    return View(
        image_id=i,
        name=str(poses.names[i]),
        K=poses.K[i],
        R=poses.rotations[i],
        t=poses.cam_from_world[i, :, 3],
        width=int(poses.width[i]),
        height=int(poses.height[i]),
    )


def _parse_header(head: bytes, path: Path) -> tuple[int, int, int, int]:
    parts = head.split(b"&", 3)
    try:
        width, height, channels = (int(part) for part in parts[:3])
    except ValueError as error:
        raise StageError("not a COLMAP map: no width&height&channels& header", file=path) from error
    if len(parts) < 4 or min(width, height, channels) < 1:
        raise StageError("not a COLMAP map: no width&height&channels& header", file=path)
    return width, height, channels, sum(len(part) + 1 for part in parts[:3])


def read_map(path: str | os.PathLike) -> np.ndarray:
    """Read a COLMAP depth or normal map.

    Returns
    -------
    ndarray of shape (height, width) or (height, width, channels), float32

    Raises
    ------
    StageError
        If the file is missing, no map or cut short.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise StageError("the depth or normal map is missing", file=path) from error
    width, height, channels, start = _parse_header(content[:_HEADER_BYTES], path)
    if len(content) - start != 4 * width * height * channels:
        raise StageError(
            f"the map is cut short: {len(content) - start} bytes of data, "
            f"expected {4 * width * height * channels}",
            file=path,
        )
    planes = np.frombuffer(content, dtype="<f4", offset=start).reshape(channels, height, width)
    return planes[0].copy() if channels == 1 else np.ascontiguousarray(np.moveaxis(planes, 0, -1))


def write_map(path: str | os.PathLike, array: np.ndarray) -> None:
    """Write a map in COLMAP's layout, atomically.

    Parameters
    ----------
    array : ndarray of shape (height, width) or (height, width, channels)
        Stored as float32.

    Raises
    ------
    ValueError
        If the array has another number of dimensions.
    """
    if array.ndim not in (2, 3):
        raise ValueError(f"a map must have 2 or 3 dimensions, got shape {array.shape}")
    planes = np.asarray(array, dtype="<f4")
    planes = planes[None] if planes.ndim == 2 else np.moveaxis(planes, -1, 0)
    channels, height, width = planes.shape
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write(f"{width}&{height}&{channels}&".encode("ascii"))
        file.write(np.ascontiguousarray(planes).tobytes())


def is_valid_map(path: str | os.PathLike, size: tuple[int, int], channels: int) -> bool:
    """Whether a file is a whole map of ``size`` (width, height); reads the header only."""
    path = Path(path)
    try:
        with open(path, "rb") as file:
            width, height, found, start = _parse_header(file.read(_HEADER_BYTES), path)
    except (OSError, StageError):
        return False
    expected = start + 4 * width * height * found
    return (width, height) == size and found == channels and path.stat().st_size == expected
