"""A sparse model with the true cameras of a rendered scene and points from its photos.

The stereo stage plans its views and starts its depths from sparse points. They must not come from
the true surface, which the stage is judged against: real features of the photos, matched and
verified as for any scan, are triangulated with the true poses held fixed.
"""

from __future__ import annotations

import logging
import os
import tempfile
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.files import temporary_folder
from cherrypicker.poses import Poses, read_poses
from cherrypicker.sfm.database import SCRATCH, copy_database
from cherrypicker.sfm.export import write_model

logger = logging.getLogger(__name__)


def triangulate_true_cameras(
    database: str | os.PathLike,
    photos: str | os.PathLike,
    poses: str | os.PathLike,
    model_folder: str | os.PathLike,
    *,
    seed: int = 0,
    threads: int = 1,
) -> dict:
    """Triangulate verified matches with known poses and write the model.

    The database is COLMAP's, as the sparse stage writes it, the poses are
    ``{scene}/truth/poses.npz``. The model's folder takes COLMAP's binary files, in the scene's
    metric frame. Returns ``n_photos``, ``n_points``, ``mean_reprojection_error_px``. Raises a
    `StageError` if a photo has no true pose, or nothing can be triangulated.
    """
    true = read_poses(poses)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = threads, seed
    pycolmap.set_random_seed(seed)
    with temporary_folder(Path(model_folder).parent, SCRATCH) as scratch:
        working = copy_database(database, scratch / "database.db")
        with_poses = _model_of_poses(working, true, poses)
        with tempfile.TemporaryDirectory(dir=scratch) as output:
            model = pycolmap.triangulate_points(
                with_poses, working, photos, output, clear_points=True, options=options
            )
    if model.num_points3D() == 0:
        raise StageError("no point can be triangulated with the true poses", file=poses)
    index = {str(name): i for i, name in enumerate(true.names)}
    for image in model.images.values():
        pose = image.cam_from_world().matrix()
        if np.abs(pose - true.cam_from_world[index[image.name]]).max() > 1e-9:
            raise StageError(f"triangulation moved the camera of {image.name}")
    write_model(model, model_folder)
    report = {
        "n_photos": model.num_reg_images(),
        "n_points": model.num_points3D(),
        "mean_reprojection_error_px": model.compute_mean_reprojection_error(),
    }
    logger.info("true cameras of %(n_photos)d photos, %(n_points)d points", report)
    return report


def _model_of_poses(database: Path, true: Poses, path) -> pycolmap.Reconstruction:
    """Give the database the true cameras, and return a model of its photos without points."""
    index = {str(name): i for i, name in enumerate(true.names)}
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as opened:
        images = sorted(opened.read_all_images(), key=lambda image: image.image_id)
        missing = [image.name for image in images if image.name not in index]
        if missing:
            raise StageError(f"no true pose of {', '.join(missing)}", file=path)
        for camera in opened.read_all_cameras():
            of_it = [index[image.name] for image in images if image.camera_id == camera.camera_id]
            pinhole = _true_camera(camera.camera_id, of_it, true, path)
            opened.update_camera(pinhole)  # COLMAP compares the models of the two
            model.add_camera_with_trivial_rig(pinhole)
        for image in images:
            pose = pycolmap.Rigid3d(true.cam_from_world[index[image.name]])
            with_pose = pycolmap.Image(
                name=image.name, camera_id=image.camera_id, image_id=image.image_id
            )
            model.add_image_with_trivial_frame(with_pose, pose)
    return model


def _true_camera(camera_id: int, photos: list[int], true: Poses, path) -> pycolmap.Camera:
    """Return the pinhole that these photos share."""
    K = true.K[photos]
    if len(photos) == 0 or np.ptp(K, axis=0).max() > 1e-6:
        raise StageError("photos of one camera must have equal true intrinsics", file=path)
    return pycolmap.Camera(
        camera_id=camera_id,
        model="PINHOLE",
        width=int(true.width[photos[0]]),
        height=int(true.height[photos[0]]),
        params=[K[0, 0, 0], K[0, 1, 1], K[0, 0, 2], K[0, 1, 2]],
    )
