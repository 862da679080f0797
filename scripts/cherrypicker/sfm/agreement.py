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

# Matches of a pair that is asked: fewer may all be wrong (guess; COLMAP registers a photo by 30)
LEAST_MATCHES = 30


@dataclass(frozen=True)
class VerifiedPair:
    """Matches of two photos that a two-view geometry supports."""

    # first, second: COLMAP's photo ids
    first: int
    second: int
    # pixels1, pixels2: (n, 2) float64: positions of the matches, px
    pixels1: np.ndarray
    pixels2: np.ndarray


@dataclass(frozen=True)
class Agreement:
    """Verdict of the verified pairs on a model."""

    n_pairs: int  # verified pairs of which both photos are registered
    pairs: float  # share of them most of whose matches fit the model's epipolar geometry
    matches: float  # share of all their matches that fit
    median_error_px: float  # median over the pairs of the median Sampson error, px


def read_verified_pairs(database: Path, min_inliers: int = LEAST_MATCHES) -> list[VerifiedPair]:
    """Read the pairs of photos with at least ``min_inliers`` verified matches."""
    with pycolmap.Database.open(database) as opened:
        pair_ids, geometries = opened.read_two_view_geometries()
        pixels: dict[int, np.ndarray] = {}
        pairs = []
        for pair_id, geometry in zip(pair_ids, geometries):
            matches = np.array(geometry.inlier_matches, dtype=np.int64).reshape(-1, 2)
            if len(matches) < min_inliers:
                continue
            ids = pycolmap.pair_id_to_image_pair(pair_id)
            for image_id in ids:
                if image_id not in pixels:
                    keypoints = np.array(opened.read_keypoints(image_id)[:, :2], dtype=np.float64)
                    pixels[image_id] = keypoints
            first, second = (pixels[i][matches[:, k]] for k, i in enumerate(ids))
            pairs.append(VerifiedPair(*ids, first, second))
    return pairs


def measure_agreement(
    model: pycolmap.Reconstruction, pairs: list[VerifiedPair], max_error_px: float
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
    medians, shares, n_matches = [], [], []
    for pair in pairs:
        errors = epipolar_errors(model, pair)
        if errors is None:
            continue
        medians.append(np.median(errors))
        shares.append(np.mean(errors <= max_error_px))
        n_matches.append(len(errors))
    if not medians:
        return Agreement(0, 0.0, 0.0, float("inf"))
    return Agreement(
        n_pairs=len(medians),
        pairs=float(np.mean(np.array(shares) > 0.5)),
        matches=float(np.average(shares, weights=n_matches)),
        median_error_px=float(np.median(medians)),
    )


def epipolar_errors(model: pycolmap.Reconstruction, pair: VerifiedPair) -> np.ndarray | None:
    """Return the Sampson errors of a pair's matches in px, None where a photo has no pose."""
    if pair.first not in model.images or pair.second not in model.images:
        return None
    images = [model.images[i] for i in (pair.first, pair.second)]
    if not all(image.has_pose for image in images):
        return None
    cameras = [model.cameras[image.camera_id] for image in images]
    rays = [
        np.asarray(camera.cam_from_img(pixels), dtype=np.float64).reshape(-1, 2)
        for camera, pixels in zip(cameras, (pair.pixels1, pair.pixels2))
    ]
    second_from_first = images[1].cam_from_world() * images[0].cam_from_world().inverse()
    E = pycolmap.essential_matrix_from_pose(second_from_first)
    focal = np.mean([camera.mean_focal_length() for camera in cameras])
    errors = focal * np.sqrt(pycolmap.compute_squared_sampson_error(rays[0], rays[1], E))
    return np.where(np.isfinite(errors), errors, np.inf)
