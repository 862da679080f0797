"""COLMAP's dense workspace: undistorted cameras and photos, depth and normal maps.

A map file is the text ``width&height&channels&`` followed by little-endian float32, one channel
after the other, rows from the top, as ``pycolmap.DepthMap`` and ``pycolmap.NormalMap`` write it.
"""

import os
from functools import cached_property
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path, read_json, write_json
from cherrypicker.lens import read_model
from cherrypicker.placement.region import Region, find_region
from cherrypicker.poses import View
from cherrypicker.sfm.export import poses_of

PHOTOMETRIC, GEOMETRIC = "photometric", "geometric"


class Workspace:
    """Paths and cameras of a dense workspace, as ``pycolmap.undistort_images`` leaves it.

    It may be of a scan of several trees, see :func:`cherrypicker.placement.region.find_region`. Its
    ``views`` are its poses, one by one.

    Raises
    ------
    StageError
        If the workspace has no readable sparse model or a camera that is no pinhole.
    """

    def __init__(self, folder: str | os.PathLike, *, several: bool = False):
        self.folder = Path(folder)
        self.several = several
        self.model = read_model(self.folder / "sparse")
        if self.model.num_reg_images() < 2:
            raise StageError(
                f"dense stereo needs two registered photos, got {self.model.num_reg_images()}",
                file=self.folder / "sparse",
                key="sfm.min_registered_fraction",
            )
        for camera in self.model.cameras.values():
            if camera.model.name not in ("PINHOLE", "SIMPLE_PINHOLE"):
                raise StageError(
                    f"a camera is {camera.model.name}, not an undistorted pinhole",
                    file=self.folder / "sparse",
                )
        self.poses = poses_of(self.model)
        self.views = list(self.poses)

    @cached_property
    def region(self) -> Region | None:
        """The scan's region of interest; None where its cameras look at no common place."""
        return find_region(self.poses, several=self.several)

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
        return is_whole_map(self.depth_path(view, kind), size, 1) and is_whole_map(
            self.normal_path(view, kind), size, 3
        )

    def read_depth(self, view: View, kind: str) -> np.ndarray:
        """Read a depth map, (height, width) float32, 0 where unknown."""
        return read_map(self.depth_path(view, kind), (view.width, view.height), 1)

    def read_normals(self, view: View, kind: str) -> np.ndarray:
        """Read a normal map, (height, width, 3) float32, camera frame, towards the camera."""
        return read_map(self.normal_path(view, kind), (view.width, view.height), 3)

    def write_maps(self, view: View, kind: str, depth: np.ndarray, normals: np.ndarray) -> None:
        """Write depth (height, width) and normals (height, width, 3), each atomically."""
        write_map(self.normal_path(view, kind), normals)
        write_map(self.depth_path(view, kind), depth)

    def keep_maps_of(self, settings: str) -> None:
        """Remove the maps that were made with other settings, and note these for those that come.

        Whole maps of a workspace in which nobody noted any are another program's, and stay until
        the settings change.
        """
        path = self.folder / "stereo" / "keys.json"
        if path.exists() and read_json(path).get("settings") != settings:
            for old in path.parent.glob("*_maps/*.bin"):
                old.unlink()
        write_json(path, {"settings": settings})

    def write_fusion_config(self) -> None:
        """Write ``stereo/fusion.cfg``, the photos that COLMAP's fusion goes through."""
        path = self.folder / "stereo" / "fusion.cfg"
        with atomic_path(path) as temporary:
            temporary.write_text("".join(f"{view.name}\n" for view in self.views), encoding="utf-8")


def workspace_of(**parts: str | os.PathLike) -> Path:
    """Return the workspace whose parts ``images``, ``sparse`` and ``stereo`` these folders are.

    Raises
    ------
    StageError
        If one has another name, or they do not lie in one folder.
    """
    folders = {Path(path).parent for path in parts.values()}
    if len(folders) > 1 or any(Path(path).name != name for name, path in parts.items()):
        where = " and ".join(map(str, parts.values()))
        raise StageError(f"{where} are not {' and '.join(parts)} of one workspace")
    return folders.pop()


def read_map(path: str | os.PathLike, size: tuple[int, int], channels: int) -> np.ndarray:
    """Read a COLMAP depth (height, width) or normal map (height, width, 3), float32.

    It has 1 or 3 channels and the ``size`` of its photo, width and height, px.

    Raises
    ------
    StageError
        If the file is missing or no whole map of that size.
    """
    if not is_whole_map(path, size, channels):
        what = "no COLMAP map of its photo's size, or cut short"
        what = what if Path(path).exists() else "missing"
        raise StageError(f"the depth or normal map is {what}", file=path)
    start = len(_header(*size, channels))
    planes = np.fromfile(path, "<f4", offset=start).reshape(channels, *size[::-1])
    return planes[0] if channels == 1 else np.ascontiguousarray(np.moveaxis(planes, 0, -1))


def write_map(path: str | os.PathLike, array: np.ndarray) -> None:
    """Write a map (height, width) or (height, width, channels) as float32, atomically."""
    planes = np.asarray(array, dtype="<f4")
    planes = planes[None] if planes.ndim == 2 else np.moveaxis(planes, -1, 0)
    channels, height, width = planes.shape
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write(_header(width, height, channels))
        file.write(np.ascontiguousarray(planes).tobytes())


def is_whole_map(path: str | os.PathLike, size: tuple[int, int], channels: int) -> bool:
    """Whether a file is a whole map of ``size`` (width, height); reads the header only."""
    header = _header(*size, channels)
    try:
        with open(path, "rb") as file:
            begins = file.read(len(header)) == header
        return begins and os.stat(path).st_size == len(header) + 4 * size[0] * size[1] * channels
    except OSError:
        return False


def _header(width: int, height: int, channels: int) -> bytes:
    return f"{width}&{height}&{channels}&".encode("ascii")
