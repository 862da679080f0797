"""The ways to build a model, the configured one first, and which to try after which failure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pycolmap

from cherrypicker.sfm.photo_files import MIN_PHOTOS


@dataclass(frozen=True)
class Policy:
    """One way to build a model from the verified matches."""

    name: str
    mapper: str  # {"incremental", "global"}
    reason: str  # what the policy does differently, for the log
    pooled: bool = False  # match the photos that are missing anew first, by pooled descriptors
    trust_exif_focal: bool = True  # false starts every focal length from 1.2 times the longer side


def further_policies(mapper: str, *, too_few: bool, has_exif_focal: bool) -> list[Policy]:
    """Return what to try when the configured way fails, the most promising first.

    Parameters
    ----------
    too_few : bool
        True where photos are missing from the model, False where the model contradicts the matches.
    has_exif_focal : bool
        Whether some focal length came from EXIF, which may be wrong.
    """
    if too_few:
        reason = "the missing photos matched anew by pooled descriptors"
        policies = [
            Policy("guided", mapper, "verified pairs matched again along their epipolar lines"),
            Policy("pooled", mapper, reason, pooled=True),
        ]
    else:
        other = "global" if mapper == "incremental" else "incremental"
        policies = [Policy(other, other, f"the {other} mapper")]
    if has_exif_focal:
        reason = "EXIF focal lengths ignored"
        policies.append(Policy("no_exif_focal", mapper, reason, trust_exif_focal=False))
    return policies


def incremental_options(seed: int, threads: int) -> pycolmap.IncrementalPipelineOptions:
    """Return COLMAP's options of incremental mapping."""
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    options.num_threads = options.mapper.num_threads = threads
    options.min_model_size = MIN_PHOTOS
    return options


def global_options(seed: int, threads: int, photos: Path) -> pycolmap.GlobalPipelineOptions:
    """Return COLMAP's options of global mapping."""
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads = options.mapper.num_threads = threads
    options.random_seed = options.mapper.random_seed = seed
    options.mapper.rotation_averaging.random_seed = seed
    options.mapper.global_positioning.random_seed = seed
    options.mapper.global_positioning.use_gpu = False
    options.mapper.bundle_adjustment.ceres.use_gpu = False
    options.image_path = photos
    return options
