"""The ways to build a model, the configured one first, and which to try after which failure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pycolmap

# COLMAP's own limits of the incremental mapper
COLMAP = pycolmap.IncrementalMapperOptions()
# Largest reprojection error of an observation where the model contradicts the matches, px: half of
# COLMAP's (guess)
TIGHT_PX = 2.0
# Photos of the smallest model that is kept: two give no scale to what a third sees
LEAST_MODEL = 3


@dataclass(frozen=True)
class Policy:
    """One way to build a model from the verified matches."""

    name: str
    mapper: str  # {"incremental", "global"}
    reason: str  # what the policy does differently, for the log
    # Verify all pairs again with this largest epipolar error, px; 0 keeps what matching found
    recheck_error_px: float = 0.0
    # Largest reprojection error of an observation, px
    filter_error_px: float = COLMAP.filter_max_reproj_error
    pooled: bool = False  # match the photos that are missing anew first, by pooled descriptors
    trust_exif_focal: bool = True  # false starts every focal length from 1.2 times the longer side


def further_policies(
    mapper: str, max_error_px: float, *, too_few: bool, has_exif_focal: bool
) -> list[Policy]:
    """Return what to try when the configured way fails, the most promising first.

    Parameters
    ----------
    max_error_px : float
        Largest epipolar error that matching allowed, px.
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
        half_px = max_error_px / 2
        reason = f"pairs verified again at {half_px:g} px, observations within {TIGHT_PX:g} px"
        tight = Policy("tight", mapper, reason, half_px, TIGHT_PX)
        other = "global" if mapper == "incremental" else "incremental"
        policies = [tight, Policy(other, other, f"the {other} mapper")]
    if has_exif_focal:
        no_focal = Policy("no_exif_focal", mapper, "EXIF focal lengths ignored")
        policies.append(replace(no_focal, trust_exif_focal=False))
    return policies


def incremental_options(
    policy: Policy, seed: int, threads: int
) -> pycolmap.IncrementalPipelineOptions:
    """Return COLMAP's options of incremental mapping."""
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    options.num_threads = options.mapper.num_threads = threads
    options.min_model_size = LEAST_MODEL
    options.mapper.filter_max_reproj_error = policy.filter_error_px
    options.triangulation.merge_max_reproj_error = policy.filter_error_px
    options.triangulation.complete_max_reproj_error = policy.filter_error_px
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
