"""How well a model agrees with the pairwise matches that it was, or was not, built from.

A model whose ring of cameras is bent fits its own tracks: it has dropped the matches that
contradict it. The verified two-view matches remember them, those that close the ring above all. So
every verified pair of photos is judged by its epipolar error under the model's poses.
"""

from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.sfm.database import verified_pairs
from cherrypicker.sfm.matching import MAX_ERROR_PX

# Matches of a pair that is asked, as many as COLMAP registers a photo by: fewer may all be wrong
LEAST_MATCHES = pycolmap.IncrementalMapperOptions().abs_pose_min_num_inliers

# COLMAP's ids of two photos, and where in each their verified matches lie, px, (n, 2) float64
VerifiedPairs = dict[tuple[int, int], tuple[np.ndarray, np.ndarray]]


def read_verified_pairs(database: Path) -> VerifiedPairs:
    """Read the pairs of photos with at least `LEAST_MATCHES` verified matches."""
    with pycolmap.Database.open(database) as opened:
        pixels = {
            image.image_id: opened.read_keypoints(image.image_id)[:, :2].astype(np.float64)
            for image in opened.read_all_images()
        }
        return {
            (first, second): (
                pixels[first][geometry.inlier_matches[:, 0]],
                pixels[second][geometry.inlier_matches[:, 1]],
            )
            for (first, second), geometry in verified_pairs(opened, LEAST_MATCHES).items()
        }


def measure_agreement(model: pycolmap.Reconstruction, pairs: VerifiedPairs) -> tuple[float, int]:
    """Judge a model by the verified pairs among its registered photos: their share and number.

    The share is that of pairs most of whose matches fit the model's epipolar geometry, to a Sampson
    error of `MAX_ERROR_PX` at most; 0 of none.
    """
    registered = set(model.reg_image_ids())
    fits = []
    for ids, matches in pairs.items():
        if not registered.issuperset(ids):
            continue
        first, second = (model.images[i] for i in ids)
        cameras = [model.cameras[image.camera_id] for image in (first, second)]
        rays = [np.asarray(camera.cam_from_img(at)) for camera, at in zip(cameras, matches)]
        second_from_first = second.cam_from_world() * first.cam_from_world().inverse()
        E = pycolmap.essential_matrix_from_pose(second_from_first)
        focal = np.mean([camera.mean_focal_length() for camera in cameras])
        errors = focal * np.sqrt(pycolmap.compute_squared_sampson_error(rays[0], rays[1], E))
        fits.append(np.mean(errors <= MAX_ERROR_PX) > 0.5)
    return float(np.mean(fits or [False])), len(fits)
