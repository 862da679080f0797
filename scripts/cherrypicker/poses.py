"""Camera poses of undistorted pinhole photos."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from cherrypicker.errors import StageError
from cherrypicker.files import read_npz, write_npz

_SHAPES = {"cam_from_world": (3, 4), "K": (3, 3), "width": (), "height": ()}
_OPTIONAL = {"error_px": ()}


@dataclass(frozen=True)
class View:
    """An undistorted photo with its camera."""

    name: str  # its file name
    K: np.ndarray  # (3, 3) float64: pinhole intrinsics, px, pixel centres at (0.5, 0.5)
    # R, t: (3, 3) and (3,) float64: camera from world
    R: np.ndarray
    t: np.ndarray
    # width, height: size of the undistorted photo, px
    width: int
    height: int

    @property
    def center(self) -> np.ndarray:
        """Camera centre in the world, (3,)."""
        return -self.R.T @ self.t

    def kernel_camera(self, width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """K, R and t at another size, with pixel centres at whole numbers as the kernels index."""
        K = np.diag([width / self.width, height / self.height, 1.0]) @ self.K
        K[:2, 2] -= 0.5
        return K, self.R, self.t

    def check_size(self, picture: np.ndarray, file: str | os.PathLike) -> None:
        """Refuse a photo or a map of it, (height, width, ...), of another size than the camera's.

        Raises
        ------
        StageError
            Naming the file.
        """
        if picture.shape[:2] != (self.height, self.width):
            raise StageError(
                f"what belongs to the undistorted photo {self.name} is {picture.shape[1]} x "
                f"{picture.shape[0]} px, its camera {self.width} x {self.height} px",
                file=file,
            )

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project points of the world (n_points, 3).

        Returns
        -------
        uv : ndarray of shape (n_points, 2)
            Pixel coordinates, centres at (0.5, 0.5); NaN at depth zero.
        depth : ndarray of shape (n_points,)
            Depth along the optical axis, negative behind the camera.
        """
        in_camera = points @ self.R.T + self.t
        with np.errstate(divide="ignore", invalid="ignore"):
            homogeneous = in_camera @ self.K.T
            uv = homogeneous[:, :2] / homogeneous[:, 2:]
        return uv, in_camera[:, 2]

    def rays(self, uv: np.ndarray) -> np.ndarray:
        """Directions of pixels (n, 2) from the centre into the world, of depth 1, (n, 3)."""
        pixels = np.column_stack([uv, np.ones(len(uv))])
        return pixels @ np.linalg.inv(self.K).T @ self.R


@dataclass
class Poses:
    """Poses and intrinsics of the registered photos."""

    names: np.ndarray  # (n_photos,) str: photo file names
    # (n_photos, 3, 4) float64: COLMAP's convention: x right, y down, z forward
    cam_from_world: np.ndarray
    # (n_photos, 3, 3) float64: intrinsics of the undistorted pinhole, px; pixel centres lie at
    # (0.5, 0.5)
    K: np.ndarray
    # width, height: (n_photos,) int: size of the undistorted photo, px
    width: np.ndarray
    height: np.ndarray
    # (n_photos,) float64: standard error of where a photo shows a point of the tree, px of the
    # undistorted photo; 0 where nobody measured it
    error_px: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self.names = np.asarray(self.names, dtype=str)
        self.cam_from_world = np.asarray(self.cam_from_world, dtype=np.float64)
        self.K = np.asarray(self.K, dtype=np.float64)
        self.width = np.asarray(self.width, dtype=np.int64)
        self.height = np.asarray(self.height, dtype=np.int64)
        measured = np.asarray(self.error_px, dtype=np.float64)
        self.error_px = measured if measured.size else np.zeros(len(self.names))
        for name, shape in (_SHAPES | _OPTIONAL).items():
            actual, wanted = getattr(self, name).shape, (len(self.names), *shape)
            if actual != wanted:
                raise ValueError(f"{name} must have shape {wanted}, got {actual}")

    def __len__(self) -> int:
        return len(self.names)

    @property
    def rotations(self) -> np.ndarray:
        """Rotations cam from world, (n_photos, 3, 3)."""
        return self.cam_from_world[:, :, :3]

    @property
    def centers(self) -> np.ndarray:
        """Camera centres in the world, (n_photos, 3)."""
        return camera_centers(self.cam_from_world)

    @property
    def forward(self) -> np.ndarray:
        """Unit viewing directions in the world, (n_photos, 3)."""
        return self.rotations[:, 2, :]

    @property
    def up(self) -> np.ndarray:
        """Unit directions of the image's top edge in the world, (n_photos, 3)."""
        return -self.rotations[:, 1, :]

    def select(self, index: np.ndarray) -> Poses:
        """Return the photos of a boolean mask or an index array."""
        arrays = {name: getattr(self, name)[index] for name in ("names", *_SHAPES, *_OPTIONAL)}
        return Poses(**arrays)

    def transformed(
        self,
        scale: float = 1.0,
        rotation: np.ndarray | None = None,
        translation: npt.ArrayLike = (0.0, 0.0, 0.0),
    ) -> Poses:
        """Return the poses in the world ``x' = scale * R x + t``."""
        rotation = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
        centers = scale * self.centers @ rotation.T + np.asarray(translation, dtype=np.float64)
        rotations = self.rotations @ rotation.T
        offsets = -np.einsum("nij,nj->ni", rotations, centers)
        return replace(
            self, cam_from_world=np.concatenate([rotations, offsets[:, :, None]], axis=2)
        )

    def resized(self, width: np.ndarray, height: np.ndarray) -> Poses:
        """Return the poses of the photos at other sizes, (n_photos,) int64 each."""
        share = np.stack([width / self.width, height / self.height, np.ones(len(self))], axis=1)
        return replace(self, K=share[:, :, None] * self.K, width=width, height=height)

    def frames(self, points: np.ndarray, nearest: np.ndarray | float = 0.0) -> np.ndarray:
        """Which photo frames which points (n_points, 3), (n_photos, n_points) bool.

        Only what lies deeper than ``nearest`` counts, one depth or one a photo.
        """
        framed = []
        for view, least in zip(self, np.broadcast_to(nearest, len(self)), strict=True):
            pixels, depth = view.project(points)
            inside = ((pixels >= 0.0) & (pixels < [view.width, view.height])).all(axis=1)
            framed.append((depth > least) & inside)
        return np.stack(framed)

    def __getitem__(self, i: int) -> View:
        """Photo ``i``."""
        size = int(self.width[i]), int(self.height[i])
        pose = self.cam_from_world[i]
        return View(str(self.names[i]), self.K[i], pose[:, :3], pose[:, 3], *size)

    def __iter__(self) -> Iterator[View]:
        return map(self.__getitem__, range(len(self)))


def camera_centers(cam_from_world: np.ndarray) -> np.ndarray:
    """Where cameras of poses (n, 3, 4) stand, (n, 3)."""
    return -np.einsum("nji,nj->ni", cam_from_world[:, :, :3], cam_from_world[:, :, 3])


def read_poses(path: str | os.PathLike) -> Poses:
    """Read a poses NPZ.

    Raises
    ------
    StageError
        If the file is missing, holds pickled objects, lacks an array, has wrong shapes, no photo
        or values that are not finite.
    """
    arrays = read_npz(path, required=("names", *_SHAPES))
    try:
        wanted = ("names", *_SHAPES, *(name for name in _OPTIONAL if name in arrays))
        poses = Poses(**{name: arrays[name] for name in wanted})
    except ValueError as error:
        raise StageError(str(error), file=path) from error
    if len(poses) == 0:
        raise StageError("no photo has a pose", file=path)
    if not (np.isfinite(poses.cam_from_world).all() and np.isfinite(poses.K).all()):
        raise StageError("a pose or an intrinsic is not finite", file=path)
    return poses


def write_poses(path: str | os.PathLike, poses: Poses) -> None:
    """Write poses as NPZ, atomically.

    Raises
    ------
    StageError
        If there is no pose: an empty result is never passed on.
    """
    if len(poses) == 0:
        raise StageError("nothing to write: no photo has a pose", file=path)
    write_npz(
        path, names=poses.names, **{name: getattr(poses, name) for name in _SHAPES | _OPTIONAL}
    )
