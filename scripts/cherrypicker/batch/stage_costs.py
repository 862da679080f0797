"""What each stage costs: CPU time, memory and disk as linear functions of the size of a scan.

The one place for these numbers, but those of the stereo, which stand with its backends. They were
fitted to Snakemake's benchmark files and to peak memory of single stages; docs/lab/cluster.md has
the runs. Memory is an upper line through the measured peaks, CPU time the middle of the measured
times. ``2 + 0.2 photo_mp`` is two, and a fifth of the photos' megapixels: the quantities are those
of :meth:`cherrypicker.batch.resources.ScanSize.quantities`, those of photos 0 for a ready cloud.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

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
    """Cost of one stage."""

    cpu_s: str
    memory_mb: str  # resident memory of the stage's process
    thread_memory_mb: str = ""  # what each thread adds to it
    disk_mb: str = ""  # what the stage leaves on disk
    max_threads: int = 1  # threads beyond which the stage gains nothing


def weigh(formula: str, quantities: Mapping[str, float]) -> float:
    """Return the value of a formula of this table."""
    total = 0.0
    for term in filter(None, formula.split(" + ")):
        *factor, last = term.split()
        value = quantities[last] if last.isidentifier() else float(last)
        total += value * (float(factor[0]) if factor else 1.0)
    return total


def stereo_stage(backend: Backend) -> StageCost:
    """Return what ``estimate_depth`` costs with a backend."""
    # Two depth maps of 4 and two normal maps of 12 bytes a pixel, where they stay, and the depths
    disk_mb = "32 kept_mp + 0.4 dense_mp"
    return StageCost(backend.cpu_s, backend.memory_mb, "", disk_mb, backend.max_threads)


# In the order in which a tree goes through them. A point in our PLY files, with colour, normal and
# the number of views, has 32 bytes, a label and its confidence 5
_LABELLED = "37 cropped_m"
_ALL = {
    "prepare_photos": StageCost(
        "2 + 0.2 photo_mp", "200", "20 largest_photo_mp", "0.8 photo_mp", 4
    ),
    "extract_features": StageCost(
        "2 + 0.24 sift_mp + 0.18 photo_mp", "200", "300 largest_feature_mp", "0.7 photos", 8
    ),
    "match_features": StageCost("2 + 0.06 pairs", "220 + 3 photos", "", "photos", 8),
    "reconstruct_sparse": StageCost(
        "2 + 0.1 photos + 0.017 photos_squared", "220 + 4 photos", "", "0.1 photos", 8
    ),
    "undistort_photos": StageCost(
        "1 + 0.13 photo_mp", "140", "7 largest_photo_mp", "0.6 kept_mp", 4
    ),
    "segment_sky": StageCost(
        "2 + 0.65 photos + 0.13 photo_mp", "690 + 20 largest_photo_mp", "", "0.01 photo_mp", 2
    ),
    "gather_evidence": StageCost(
        "1.5 + 0.04 dense_mp", "200 + 20 largest_photo_mp", "", "0.1 dense_mp"
    ),
    "estimate_depth": stereo_stage(BACKENDS["cpu"]),
    # Twigs from silhouettes take 0.3 CPU seconds a megapixel of these, and 4 bytes a pixel when the
    # fusion has given back its own
    "fuse_depth": StageCost(
        "2 + 0.67 dense_mp", "320 + fusion_mb + 4 dense_mp + 120 points_m", "", "32 points_m", 4
    ),
    "align_cloud": StageCost("1.5 + 0.7 points_m", "150 + 160 points_m", "", "32 points_m"),
    "crop_roi": StageCost("1 + 0.5 points_m", "130 + 150 points_m", "", "32 cropped_m"),
    "denoise_cloud": StageCost(
        "5 + 7.5 cropped_m", "600 + 125 cropped_m + 20 largest_photo_mp", "", "32 cropped_m", 2
    ),
    "estimate_scale": StageCost(
        "1 + 0.37 photos + 0.03 photo_mp", "400 + 10 largest_photo_mp", max_threads=2
    ),
    "scale_cloud": StageCost("0.5 + 0.4 cropped_m", "80 + 125 cropped_m", "", "32 cropped_m"),
    "import_cloud": StageCost("1 + 2 points_m", "130 + 250 points_m", "", "32 points_m"),
    "segment_cloud": StageCost("44 + 4.6 cropped_m", "750 + 215 cropped_m", "", _LABELLED, 2),
    # The skeleton is drawn from a bounded number of points, so its time hardly grows with the
    # cloud; the bases are those of a tree of 2.8 m with 68 m of wood
    "contract_cloud": StageCost("4 + 0.6 cropped_m", "450 + 60 cropped_m", "", "0.6", 2),
    "extract_graph": StageCost(
        "36 + 0.6 cropped_m + 0.06 dense_mp",
        "290 + 125 cropped_m + 20 largest_photo_mp",
        disk_mb="1.5",
        max_threads=2,
    ),
    "check_photos": StageCost(
        "8 + 0.2 dense_mp + 0.02 photo_mp",
        "450 + 5 dense_mp + 125 cropped_m + 20 largest_photo_mp",
        disk_mb="1",
        max_threads=4,
    ),
    "measure_traits": StageCost("14 + 1.8 cropped_m", "640 + 130 cropped_m"),
    "report_tree": StageCost(
        "14 + 3.5 cropped_m", "850 + 270 cropped_m + 20 largest_photo_mp", disk_mb="9"
    ),
}
_PHOTOS_ALONE = frozenset(_ALL) - {
    *("import_cloud", "segment_cloud", "contract_cloud", "extract_graph"),
    *("measure_traits", "report_tree"),
}
PREPARED = {"prepare_photos": _ALL["prepare_photos"]}  # of scans that need it alone
PHOTO_STAGES = {
    rule: cost for rule, cost in _ALL.items() if rule not in ("prepare_photos", "import_cloud")
}
CLOUD_STAGES = {rule: cost for rule, cost in _ALL.items() if rule not in _PHOTOS_ALONE}

# Of a scan of several trees, shared by them: not in the forecast of a batch, which counts a scan as
# one tree; `grow_limbs` is of clouds that came with labels, else `segment_cloud` does it
ROW_STAGES = {
    "grow_limbs": StageCost("24 + 0.6 cropped_m", "450 + 60 cropped_m"),
    "find_trees": StageCost("3 + 4 cropped_m", "450 + 1000 cropped_m"),
    "split_scan": StageCost("2 + 2 cropped_m", "200 + 250 cropped_m", "", _LABELLED),
}
