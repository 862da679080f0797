"""How well a model agrees with the pairwise matches that it was, or was not, built from.

A model whose ring of cameras is bent fits its own tracks: it has dropped the matches that
contradict it. The verified two-view matches remember them, those that close the ring above all. So
every verified pair of photos is judged by its epipolar error under the model's poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.sfm.database import verified_pairs

# Matches of a pair that is asked, as many as COLMAP registers a photo by: fewer may all be wrong
LEAST_MATCHES = pycolmap.IncrementalMapperOptions().abs_pose_min_num_inliers

# COLMAP's ids of two photos, and where in each their verified matches lie, px, (n, 2) float64
VerifiedPairs = dict[tuple[int, int], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Agreement:
    """Verdict of the verified pairs on a model."""

    n_pairs: int  # verified pairs of which both photos are registered
    pairs: float  # share of them most of whose matches fit the model's epipolar geometry
    matches: float  # share of all their matches that fit
    # Median over the pairs of the median Sampson error, px; None of no pair
    median_error_px: float | None


def read_verified_pairs(database: Path) -> VerifiedPairs:
    """Read the pairs of photos with at least `LEAST_MATCHES` verified matches."""
    with pycolmap.Database.open(database) as opened:
        pixels = {
            image.image_id: np.array(opened.read_keypoints(image.image_id), dtype=np.float64)[:, :2]
            for image in opened.read_all_images()
        }
        return {
            (first, second): (
                pixels[first][geometry.inlier_matches[:, 0]],
                pixels[second][geometry.inlier_matches[:, 1]],
            )
            for (first, second), geometry in verified_pairs(opened, LEAST_MATCHES).items()
        }


def measure_agreement(
    model: pycolmap.Reconstruction, pairs: VerifiedPairs, max_error_px: float
) -> Agreement:
    """Judge a model by the verified pairs among its registered photos.

    Parameters
    ----------
    max_error_px : float
        Largest Sampson error of a match that fits, px.

    Returns
    -------
    Agreement
        Of no pair at all: shares of 0.
    """
    registered, errors = set(model.reg_image_ids()), []
    for ids, matches in pairs.items():
        if not registered.issuperset(ids):
            continue
        first, second = (model.images[i] for i in ids)
        cameras = [model.cameras[image.camera_id] for image in (first, second)]
        rays = [
            np.asarray(camera.cam_from_img(pixels), dtype=np.float64).reshape(-1, 2)
            for camera, pixels in zip(cameras, matches)
        ]
        second_from_first = second.cam_from_world() * first.cam_from_world().inverse()
        E = pycolmap.essential_matrix_from_pose(second_from_first)
        focal = np.mean([camera.mean_focal_length() for camera in cameras])
        squared = np.array(pycolmap.compute_squared_sampson_error(*rays, E))
        errors.append(focal * np.sqrt(np.nan_to_num(squared, nan=np.inf)))
    if not errors:
        return Agreement(0, 0.0, 0.0, None)
    shares = np.array([np.mean(each <= max_error_px) for each in errors])
    return Agreement(
        n_pairs=len(errors),
        pairs=float(np.mean(shares > 0.5)),
        matches=float(np.average(shares, weights=[len(each) for each in errors])),
        median_error_px=float(np.median([np.median(each) for each in errors])),
    )
