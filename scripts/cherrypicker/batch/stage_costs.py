"""What each stage costs: CPU time, memory and disk as linear functions of the size of a scan.

The one place for these numbers, but those of the stereo, which stand with its backends. They were
fitted to Snakemake's benchmark files and to the peak memory of single stages; docs/cluster.md lists
the runs. Memory is an upper line through the measured peaks, CPU time the middle of the measured
times.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from cherrypicker.mvs.backends.table import BACKENDS, Backend

# Photos below this size are enlarged fourfold for their features, see sfm/features.py
ENLARGED_BELOW_MP = 2.0
# Points of the cloud per pixel of all depth maps: 0.048 to 0.099 were measured on 23 to 66 photos,
# 0.19 on the rehearsal's 250, whose ground is rich in texture
POINTS_PER_PIXEL = 0.10
MOST_POINTS_PER_PIXEL = 0.20
# How many of them the crop leaves: 0.36 to 0.43 were measured before hills and a field. All of a
# trunk's stay, but those clouds have half of the points at most
CROPPED_SHARE = 0.4
MOST_CROPPED_SHARE = 0.5


@dataclass(frozen=True)
class StageCost:
    """Cost of one stage; every mapping holds a quantity of the scan and its factor."""

    cpu_s: Mapping[str, float]  # CPU seconds: ``base`` and seconds per unit of a quantity
    memory_mb: Mapping[str, float]  # resident memory of the stage's process, MB
    # What each thread adds to it, MB
    thread_memory_mb: Mapping[str, float] = field(default_factory=dict)
    disk_mb: Mapping[str, float] = field(default_factory=dict)  # what the stage leaves on disk, MB
    max_threads: int = 1  # threads beyond which the stage gains nothing


# A point in our PLY files, with colour, normal and the number of views; a label and its confidence
_POINT_BYTES, _LABEL_BYTES = 32.0, 5.0
_CLOUD_MB = {"points_m": _POINT_BYTES}
_CROPPED_MB = {"cropped_m": _POINT_BYTES}
_LABELLED_MB = {"cropped_m": _POINT_BYTES + _LABEL_BYTES}


def stereo_stage(backend: Backend) -> StageCost:
    """Return what ``estimate_depth`` costs with a backend."""
    return StageCost(
        cpu_s=backend.cpu_s,
        memory_mb=backend.memory_mb,
        # Two depth maps of 4 and two normal maps of 12 bytes a pixel
        disk_mb={"dense_mp": 32.0},
        max_threads=backend.max_threads,
    )


# Of scans that need it alone
PREPARED = {
    "prepare_photos": StageCost(
        cpu_s={"base": 2.0, "photo_mp": 0.2},
        memory_mb={"base": 200.0},
        thread_memory_mb={"largest_photo_mp": 20.0},
        disk_mb={"photo_mp": 0.8},
        max_threads=4,
    )
}
PHOTO_STAGES = {
    "extract_features": StageCost(
        cpu_s={"base": 2.0, "sift_mp": 0.24, "photo_mp": 0.18},
        memory_mb={"base": 200.0},
        thread_memory_mb={"largest_feature_mp": 300.0},
        disk_mb={"photos": 0.7},
        max_threads=8,
    ),
    "match_features": StageCost(
        cpu_s={"base": 2.0, "pairs": 0.06},
        memory_mb={"base": 220.0, "photos": 3.0},
        disk_mb={"photos": 1.0},
        max_threads=8,
    ),
    "reconstruct_sparse": StageCost(
        cpu_s={"base": 2.0, "photos": 0.1, "photos_squared": 0.017},
        memory_mb={"base": 220.0, "photos": 4.0},
        disk_mb={"photos": 0.1},
        max_threads=8,
    ),
    "undistort_photos": StageCost(
        cpu_s={"base": 1.0, "photo_mp": 0.13},
        memory_mb={"base": 140.0},
        thread_memory_mb={"largest_photo_mp": 7.0},
        disk_mb={"dense_mp": 0.6},
        max_threads=4,
    ),
    "segment_sky": StageCost(
        cpu_s={"base": 2.0, "photos": 0.65, "photo_mp": 0.13},
        memory_mb={"base": 690.0, "largest_photo_mp": 20.0},
        disk_mb={"photo_mp": 0.01},
        max_threads=2,
    ),
    "gather_evidence": StageCost(
        cpu_s={"base": 1.5, "dense_mp": 0.04},
        memory_mb={"base": 200.0, "largest_photo_mp": 20.0},
        disk_mb={"dense_mp": 0.1},
    ),
    "estimate_depth": stereo_stage(BACKENDS["cpu"]),
    "fuse_depth": StageCost(
        # Twigs from silhouettes take 0.3 CPU seconds a megapixel of these, and 4 bytes a pixel when
        # the fusion has given back its own
        cpu_s={"base": 2.0, "dense_mp": 0.67},
        memory_mb={"base": 320.0, "fusion_mb": 1.0, "dense_mp": 4.0, "points_m": 120.0},
        disk_mb=_CLOUD_MB,
        max_threads=4,
    ),
    "align_cloud": StageCost(
        cpu_s={"base": 1.5, "points_m": 0.7},
        memory_mb={"base": 150.0, "points_m": 160.0},
        disk_mb=_CLOUD_MB,
    ),
    "crop_roi": StageCost(
        cpu_s={"base": 1.0, "points_m": 0.5},
        memory_mb={"base": 130.0, "points_m": 150.0},
        disk_mb=_CROPPED_MB,
    ),
    "denoise_cloud": StageCost(
        cpu_s={"base": 5.0, "cropped_m": 7.5},
        memory_mb={"base": 600.0, "cropped_m": 125.0, "largest_photo_mp": 20.0},
        disk_mb=_CROPPED_MB,
        max_threads=2,
    ),
    "estimate_scale": StageCost(
        cpu_s={"base": 1.0, "photos": 0.37, "photo_mp": 0.03},
        memory_mb={"base": 400.0, "largest_photo_mp": 10.0},
        max_threads=2,
    ),
    "scale_cloud": StageCost(
        cpu_s={"base": 0.5, "cropped_m": 0.4},
        memory_mb={"base": 80.0, "cropped_m": 125.0},
        disk_mb=_CROPPED_MB,
    ),
    "segment_cloud": StageCost(
        cpu_s={"base": 44.0, "cropped_m": 4.6},
        memory_mb={"base": 750.0, "cropped_m": 215.0},
        disk_mb=_LABELLED_MB,
        max_threads=2,
    ),
}

CLOUD_STAGES = {
    "import_cloud": StageCost(
        cpu_s={"base": 1.0, "points_m": 2.0},
        memory_mb={"base": 130.0, "points_m": 250.0},
        disk_mb=_CLOUD_MB,
    ),
    "segment_cloud": PHOTO_STAGES["segment_cloud"],
}

# The skeleton is drawn from a bounded number of points, so its time hardly grows with the cloud;
# the bases are those of a tree of 2.8 m with 68 m of wood
_TREE_STAGES = {
    "contract_cloud": StageCost(
        cpu_s={"base": 4.0, "cropped_m": 0.6},
        memory_mb={"base": 450.0, "cropped_m": 60.0},
        disk_mb={"base": 0.6},
        max_threads=2,
    ),
    "extract_graph": StageCost(
        cpu_s={"base": 36.0, "cropped_m": 0.6},
        memory_mb={"base": 290.0, "cropped_m": 125.0},
        disk_mb={"base": 1.5},
        max_threads=2,
    ),
    "measure_traits": StageCost(
        cpu_s={"base": 14.0, "cropped_m": 1.8},
        memory_mb={"base": 640.0, "cropped_m": 130.0},
    ),
    "report_tree": StageCost(
        cpu_s={"base": 14.0, "cropped_m": 3.5},
        memory_mb={"base": 850.0, "cropped_m": 270.0, "largest_photo_mp": 20.0},
        disk_mb={"base": 9.0},
    ),
}

# Photos refute what is not there, and judge the skeleton before it is measured
_GRAPH = _TREE_STAGES["extract_graph"]
_REFUTED = replace(
    _GRAPH,
    cpu_s={**_GRAPH.cpu_s, "dense_mp": 0.06},
    memory_mb={**_GRAPH.memory_mb, "largest_photo_mp": 20.0},
)
_CHECK = StageCost(
    cpu_s={"base": 8.0, "dense_mp": 0.2},
    memory_mb={"base": 450.0, "dense_mp": 5.0, "cropped_m": 125.0},
    disk_mb={"base": 1.0},
    max_threads=4,
)
PHOTO_STAGES |= {"contract_cloud": _TREE_STAGES["contract_cloud"], "extract_graph": _REFUTED}
PHOTO_STAGES |= {"check_photos": _CHECK}  # between these two: stages stand in the order of a run
PHOTO_STAGES |= {rule: _TREE_STAGES[rule] for rule in ("measure_traits", "report_tree")}
CLOUD_STAGES |= _TREE_STAGES

# Of a scan of several trees, shared by them: not in the forecast of a batch, which counts a scan as
# one tree
ROW_STAGES = {
    "grow_limbs": StageCost(  # of clouds that came with labels; else `segment_cloud` does it
        cpu_s={"base": 24.0, "cropped_m": 0.6},
        memory_mb={"base": 450.0, "cropped_m": 60.0},
    ),
    "find_trees": StageCost(
        cpu_s={"base": 3.0, "cropped_m": 4.0},
        memory_mb={"base": 450.0, "cropped_m": 1000.0},
    ),
    "split_scan": StageCost(
        cpu_s={"base": 2.0, "cropped_m": 2.0},
        memory_mb={"base": 200.0, "cropped_m": 250.0},
        disk_mb=_LABELLED_MB,
    ),
}
