"""Copies of a dense workspace for one measurement: its own maps, fewer or smaller photos."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.mvs.undistort import JPEG_QUALITY
from cherrypicker.mvs.workspace import Workspace
from cherrypicker.photos import read_photo

PARTS = ("images", "sparse", "stereo", "sky")


def copy_workspace(
    source: str | os.PathLike,
    target: str | os.PathLike,
    *,
    megapixels: float | None = None,
    max_photos: int | None = None,
) -> None:
    """Make a workspace without maps from another one.

    Parameters
    ----------
    source, target : path-like
        Dense workspaces; what the target holds is removed first.
    megapixels : float, optional
        Size of each photo; smaller than in the source. The photos are reduced by area averaging and
        the cameras and image points of the sparse model are scaled along.
    max_photos : int, optional
        Only the first photos in name order.

    Raises
    ------
    StageError
        If the photos are smaller than asked for.
    """
    source, target = Path(source), Path(target)
    workspace = Workspace(source)
    for part in PARTS:
        path = target / part
        if path.is_symlink() or path.is_file():
            path.unlink()
        shutil.rmtree(path, ignore_errors=True)
    (target / "images").mkdir(parents=True)
    (target / "sparse").mkdir()
    model = workspace.model
    names = [view.name for view in workspace.views][:max_photos]
    for image in list(model.images.values()):
        if image.has_pose and image.name not in names:
            model.deregister_frame(image.frame_id)
    if megapixels is not None:
        _scale_model(model, megapixels, source)
    model.write(target / "sparse")
    for view in Workspace(target).views:
        _copy_photo(workspace.photo_path(view), target / "images" / view.name, view)


def _scale_model(model: pycolmap.Reconstruction, megapixels: float, source: Path) -> None:
    factors = {}
    for camera_id, camera in model.cameras.items():
        factor = np.sqrt(megapixels * 1e6 / (camera.width * camera.height))
        if factor > 1.0 + 1e-6:
            raise StageError(
                f"the photos have {camera.width * camera.height / 1e6:.2f} megapixels, "
                f"{megapixels:g} were asked for",
                file=source,
                key="benchmark.sizes_mp",
            )
        size = max(round(camera.width * factor), 1), max(round(camera.height * factor), 1)
        factors[camera_id] = np.array(size) / [camera.width, camera.height]
        camera.rescale(*size)
    for image in model.images.values():
        for point in image.points2D:
            point.xy = point.xy * factors[image.camera_id]


def _copy_photo(source: Path, target: Path, view) -> None:
    photo = read_photo(source)
    if photo.shape[:2] == (view.height, view.width):
        shutil.copyfile(source, target)
        return
    reduced = cv2.resize(photo, (view.width, view.height), interpolation=cv2.INTER_AREA)
    is_jpeg = target.suffix.lower() in (".jpg", ".jpeg")
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if is_jpeg else []
    if not cv2.imwrite(str(target), cv2.cvtColor(reduced, cv2.COLOR_RGB2BGR), quality):
        raise StageError("the reduced photo cannot be written", file=target)
