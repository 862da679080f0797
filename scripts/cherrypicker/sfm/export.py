"""A model as later stages read it: COLMAP's binary files and the undistorted poses."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.files import temporary_folder
from cherrypicker.poses import Poses

MODEL_FILES = ("cameras.bin", "images.bin", "points3D.bin", "frames.bin", "rigs.bin")


def undistorted_poses(model: pycolmap.Reconstruction, errors: Mapping[str, float]) -> Poses:
    """Return the registered photos as undistorted pinholes, sorted by name.

    Each has its error at the tree, px. The pinhole is the one that ``pycolmap.undistort_camera``
    makes with its default options, which the dense stage's undistortion uses, too.
    """
    options = pycolmap.UndistortCameraOptions()
    pinholes = {i: pycolmap.undistort_camera(options, cam) for i, cam in model.cameras.items()}
    poses = poses_of(model, pinholes)
    return replace(poses, error_px=np.array([errors[name] for name in poses.names.tolist()]))


def poses_of(
    model: pycolmap.Reconstruction, cameras: Mapping[int, pycolmap.Camera] | None = None
) -> Poses:
    """Return the registered photos of a model, sorted by name, as pinholes.

    Cameras by id come in place of the model's own, whose distortion is passed over.
    """
    images = registered_photos(model)
    chosen = [(cameras or model.cameras)[image.camera_id] for image in images]
    return Poses(
        names=np.array([image.name for image in images], dtype=str),
        cam_from_world=np.array([image.cam_from_world().matrix() for image in images]),
        K=np.array([camera.calibration_matrix() for camera in chosen]),
        width=np.array([camera.width for camera in chosen]),
        height=np.array([camera.height for camera in chosen]),
    )


def registered_photos(model: pycolmap.Reconstruction) -> list[pycolmap.Image]:
    """Return the photos of a model that have a pose, sorted by name."""
    images = (image for image in model.images.values() if image.has_pose)
    return sorted(images, key=lambda image: image.name)


def write_model(model: pycolmap.Reconstruction, folder: str | os.PathLike) -> None:
    """Write the five binary files of a model, each renamed into place when all are there."""
    folder = Path(folder)
    with temporary_folder(folder, ".model.") as temporary:
        model.write_binary(temporary)
        for name in MODEL_FILES:
            (temporary / name).replace(folder / name)
