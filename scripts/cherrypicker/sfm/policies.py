"""The ways to build a model, the configured one first, and which to try after which failure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pycolmap


@dataclass(frozen=True)
class Policy:
    """One way to build a model from the verified matches.

    Attributes
    ----------
    name : str
    mapper : {"incremental", "global"}
    reason : str
        What the policy does differently, for the log.
    recheck_error_px : float
        Verify all pairs again with this largest epipolar error, px; 0 keeps what matching found.
    filter_error_px : float
        Largest reprojection error of an observation, px.
    min_inliers_pose : int
        Least inliers to register a photo.
    min_inliers_start : int
        Least inliers of the pair that a model starts from.
    guided : bool
        Search for more matches along the epipolar lines first.
    trust_exif_focal : bool
        False starts every focal length from 1.2 times the longer side.
    """

    name: str
    mapper: str = "incremental"
    reason: str = ""
    recheck_error_px: float = 0.0
    filter_error_px: float = 4.0
    min_inliers_pose: int = 30
    min_inliers_start: int = 100
    guided: bool = False
    trust_exif_focal: bool = True


def first_policy(mapper: str) -> Policy:
    """Return the configured way."""
    return Policy(name=mapper, mapper=mapper, reason="as configured")


def further_policies(
    mapper: str, max_error_px: float, *, too_few: bool, has_exif_focal: bool
) -> list[Policy]:
    """Return what to try when the configured way fails, the most promising first.

    Parameters
    ----------
    mapper : str
        The configured mapper.
    max_error_px : float
        Largest epipolar error that matching allowed, px.
    too_few : bool
        True where photos are missing from the model, False where the model contradicts the matches.
    has_exif_focal : bool
        Whether some focal length came from EXIF, which may be wrong.
    """
    base = Policy(name="", mapper=mapper)
    other = "global" if mapper == "incremental" else "incremental"
    tight = replace(
        base,
        name="tight",
        reason=f"pairs verified again at {max_error_px / 2:g} px, observations within 2 px",
        recheck_error_px=max_error_px / 2,
        filter_error_px=2.0,
    )
    swapped = replace(base, name=other, mapper=other, reason=f"the {other} mapper")
    # On rings thinned to half, the incremental mapper left cameras 12 mm off at most where the
    # global one left 57 mm.
    guided = replace(
        base,
        name="guided",
        mapper="incremental",
        reason="guided matching, the incremental mapper",
        guided=True,
    )
    guided_global = replace(
        base,
        name="guided_global",
        mapper="global",
        reason="guided matching, the global mapper",
        guided=True,
    )
    loose = replace(
        base,
        name="guided_loose",
        mapper="incremental",
        reason="guided matching, 15 inliers register a photo, 50 start a model",
        guided=True,
        min_inliers_pose=15,
        min_inliers_start=50,
    )
    no_focal = replace(
        base,
        name="no_exif_focal",
        reason="EXIF focal lengths ignored",
        trust_exif_focal=False,
    )
    policies = [guided, guided_global, loose] if too_few else [tight, swapped, guided_global]
    return [*policies, no_focal] if has_exif_focal else policies


def incremental_options(policy: Policy, seed: int, threads: int):
    """Return COLMAP's options of incremental mapping."""
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    options.num_threads = options.mapper.num_threads = threads
    options.min_model_size = 3
    options.mapper.init_min_num_inliers = policy.min_inliers_start
    options.mapper.abs_pose_min_num_inliers = policy.min_inliers_pose
    options.mapper.filter_max_reproj_error = policy.filter_error_px
    options.triangulation.merge_max_reproj_error = policy.filter_error_px
    options.triangulation.complete_max_reproj_error = policy.filter_error_px
    return options


def global_options(seed: int, threads: int, photos: Path):
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
