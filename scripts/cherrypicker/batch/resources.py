"""Threads, memory and running time to ask for, from the size of a scan.

The size comes from the headers of the photos or of the ready cloud and from the config, so that it
is known before anything is run. The rates stand in :mod:`cherrypicker.batch.stage_costs`.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from cherrypicker.batch.stage_costs import (
    CROPPED_SHARE,
    ENLARGED_BELOW_MP,
    MOST_CROPPED_SHARE,
    MOST_POINTS_PER_PIXEL,
    POINTS_PER_PIXEL,
    STAGES,
    StageCost,
    stages_of,
    weigh,
)
from cherrypicker.ply import PlyError, read_ply_header

# Snakemake itself and the job's shell run beside the stage and count towards its memory
SNAKEMAKE_MB = 250
# On the formula's peak memory and CPU time: other scans, slower nodes, a busy file system
MEMORY_MARGIN = 1.3
TIME_MARGIN = 4.0
# Start of Python, of Snakemake and of compiled kernels on a node that has none cached yet
START_MINUTES = 5
# A thread is worth asking for from this much work on
CPU_S_PER_THREAD = 120.0
# How much of further threads is used, assumed: two cores were all there was to measure on
THREAD_EFFICIENCY = 0.8
_BYTES_PER_TEXT_POINT = 30.0  # three coordinates with their blanks (guess)
# Sources of a depth map that the stereo's rate holds for
SOURCES_OF_RATE = 6.0
# Bytes a pixel of the largest map, as mvs/backends/ and mvs/fusion.py state for what they hold at a
# time: of the stereo for each source and for the photo itself, of the fusion for each map
STEREO_SOURCE_BYTES, STEREO_PHOTO_BYTES, FUSION_MAP_BYTES = 38.0, 80.0, 16.0


@dataclass(frozen=True)
class ScanSize:
    """How large a scan is, as far as its cost goes."""

    is_photo_scan: bool = False
    stereo: str = "cpu"  # the backend of its depth maps
    is_prepared: bool = False  # whether stages read prepared photos
    keeps_dense: bool = False  # whether undistorted photos and the stereo's maps stay
    n_photos: int = 0
    n_pairs: int = 0  # of photos to match
    n_sources: int = 0  # source photos of each depth map
    n_checked: int = 0  # photos that are asked about each point in the fusion
    # Megapixels of all photos: as they are, as features are sought, the same with photos that are
    # enlarged for it counted four times, and as depth is estimated; then of the largest photo
    photo_mp: float = 0.0
    feature_mp: float = 0.0
    sift_mp: float = 0.0
    dense_mp: float = 0.0
    largest_photo_mp: float = 0.0
    largest_feature_mp: float = 0.0
    largest_dense_mp: float = 0.0
    # Millions of points to expect in the cloud, and as many as memory must suffice for
    points_m: float = 0.0
    most_points_m: float = 0.0

    @property
    def stages(self) -> Mapping[str, StageCost]:
        """The stages that a scan like this goes through."""
        if not self.is_photo_scan:
            return stages_of("", "clouds")
        prepared = ["prepared photos"] if self.is_prepared else []
        return stages_of("", "photos", *prepared, stereo=self.stereo)

    def quantities(self, points_m: float, cropped_share: float) -> dict[str, float]:
        """Return what the formulas of :class:`StageCost` are of.

        Parameters
        ----------
        points_m : float
            Millions of points of the cloud.
        cropped_share : float
            How many of them the crop leaves; a ready cloud is not cropped.
        """
        return asdict(self) | {
            "photos": float(self.n_photos),
            "kept_mp": self.dense_mp if self.keeps_dense else 0.0,
            "photos_squared": float(self.n_photos) ** 2,
            "pairs": float(self.n_pairs),
            "stereo_mp": self.dense_mp * self.n_sources / SOURCES_OF_RATE,
            "stereo_mb": (STEREO_SOURCE_BYTES * self.n_sources + STEREO_PHOTO_BYTES)
            * self.largest_dense_mp,
            "fusion_mb": FUSION_MAP_BYTES * (self.n_checked + 1) * self.largest_dense_mp,
            "points_m": points_m,
            "cropped_m": points_m * (cropped_share if self.is_photo_scan else 1.0),
        }


def size_of_photos(
    sizes: Sequence[tuple[int, int]],
    settings: Mapping,
    *,
    stereo: str = "cpu",
    is_prepared: bool = False,
) -> ScanSize:
    """Return the size of a scan from photos.

    Parameters
    ----------
    sizes : sequence of (int, int)
        Width and height of each photo, px.
    settings : mapping
        The tree's whole config; the sections ``photos``, ``sfm``, ``mvs`` and ``keep`` are read.
    stereo : str, default "cpu"
        The backend of the depth maps.
    is_prepared : bool, default False
        Whether stages read prepared photos.
    """
    sfm, mvs = settings["sfm"], settings["mvs"]
    limit_px = settings["photos"]["max_size_px"]
    as_is = _megapixels(sizes, limit_px)
    features = _megapixels(
        sizes, min(sfm["max_image_size_px"] or limit_px, limit_px or sfm["max_image_size_px"])
    )
    dense = _megapixels(sizes, mvs["max_image_size_px"])
    return ScanSize(
        is_photo_scan=True,
        is_prepared=is_prepared,
        stereo=stereo,
        keeps_dense=settings["keep"]["dense"],
        n_photos=len(sizes),
        n_pairs=count_pairs(len(sizes), sfm),
        n_sources=min(mvs["n_sources"], max(len(sizes) - 1, 1)),
        n_checked=min(mvs["n_check"], max(len(sizes) - 1, 1)),
        photo_mp=sum(as_is),
        feature_mp=sum(features),
        sift_mp=sum(mp if mp >= ENLARGED_BELOW_MP else 4.0 * mp for mp in features),
        dense_mp=sum(dense),
        largest_photo_mp=max(as_is, default=0.0),
        largest_feature_mp=max(features, default=0.0),
        largest_dense_mp=max(dense, default=0.0),
        points_m=POINTS_PER_PIXEL * sum(dense),
        most_points_m=MOST_POINTS_PER_PIXEL * sum(dense),
    )


def size_of_cloud(path: str | os.PathLike) -> ScanSize:
    """Return the size of a ready cloud; of an unreadable one as if it were empty.

    That such a file is refused is the import's work.
    """
    points_m = count_points(path) / 1e6
    return ScanSize(points_m=points_m, most_points_m=points_m)


def count_points(path: str | os.PathLike) -> int:
    """Return the number of points of a PLY or LAS/LAZ file from its header.

    Text files are estimated from their length; a missing or broken file has none.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    try:
        if suffix == ".ply":
            _, elements, _, _ = read_ply_header(path)
            return max(0, sum(one.count for one in elements if one.name == "vertex"))
        if suffix in (".las", ".laz"):
            return _las_points(path)
        return int(path.stat().st_size / _BYTES_PER_TEXT_POINT)
    except (OSError, PlyError, struct.error):
        return 0


def count_pairs(n_photos: int, sfm: Mapping) -> int:
    """Return how many pairs of photos are matched, at most, with these settings.

    Parameters
    ----------
    sfm : mapping
        The config's section ``sfm``.
    """
    all_pairs = n_photos * (n_photos - 1) // 2
    pairing = sfm["pairing"]
    if pairing == "auto":
        pairing = "exhaustive" if n_photos <= sfm["exhaustive_max_photos"] else "retrieval"
    per_photo = {
        "sequential": sfm["sequential_overlap"],
        "retrieval": sfm["retrieval_neighbors"] + sfm["sequential_overlap"],
        "vocab_tree": sfm["retrieval_neighbors"],
    }.get(pairing, n_photos)
    return min(all_pairs, n_photos * per_photo)


def cpu_seconds(stage: StageCost, scan: ScanSize) -> float:
    """Return the CPU time to expect of a stage, seconds."""
    return weigh(stage.cpu_s, scan.quantities(scan.points_m, CROPPED_SHARE))


def memory_mb(stage: StageCost, scan: ScanSize, threads: int = 1) -> float:
    """Return the peak resident memory to expect of a stage, MB, without any margin."""
    quantities = scan.quantities(scan.most_points_m, MOST_CROPPED_SHARE)
    return weigh(stage.memory_mb, quantities) + threads * weigh(stage.thread_memory_mb, quantities)


def disk_mb(stage: StageCost, scan: ScanSize) -> float:
    """Return what a stage leaves on disk, MB."""
    return weigh(stage.disk_mb, scan.quantities(scan.points_m, CROPPED_SHARE))


def _stage(rule: str, scan: ScanSize) -> StageCost:
    """A stage of a scan, or of those that a scan of several trees has besides."""
    return STAGES[rule] if STAGES[rule].of == "several" else scan.stages[rule]


def threads_to_ask(rule: str, scan: ScanSize) -> int:
    """Return how many threads are worth asking for: two minutes of work each, up to the bound."""
    stage = _stage(rule, scan)
    wanted = math.ceil(cpu_seconds(stage, scan) / CPU_S_PER_THREAD)
    return max(1, min(stage.max_threads, wanted))


def mb_to_ask(rule: str, scan: ScanSize, threads: int = 1, attempt: int = 1) -> int:
    """Return the memory to ask for, MB: formula and margin, times the attempt."""
    peak = memory_mb(_stage(rule, scan), scan, threads)
    return _round_up(attempt * (SNAKEMAKE_MB + MEMORY_MARGIN * peak), 100)


def minutes_to_ask(rule: str, scan: ScanSize, threads: int = 1, attempt: int = 1) -> int:
    """Return the running time to ask for, minutes: formula and margin, times the attempt."""
    busy_s = cpu_seconds(_stage(rule, scan), scan) / speedup(threads)
    return _round_up(attempt * (START_MINUTES + TIME_MARGIN * busy_s / 60.0), 5)


def speedup(threads: int) -> float:
    """Return how much faster so many threads are than one."""
    return 1.0 + THREAD_EFFICIENCY * (max(threads, 1) - 1)


def _megapixels(sizes: Sequence[tuple[int, int]], limit_px: int) -> list[float]:
    """Megapixels of each photo once its longer side is at most ``limit_px`` (0: as it is)."""
    megapixels = []
    for width, height in sizes:
        longer = max(width, height)
        shrink = min(1.0, limit_px / longer) if limit_px and longer else 1.0
        megapixels.append(width * height * shrink**2 / 1e6)
    return megapixels


def _las_points(path: Path) -> int:
    with open(path, "rb") as stream:
        head = stream.read(255)
    if head[:4] != b"LASF":
        return 0
    (legacy,) = struct.unpack_from("<I", head, 107)
    is_long = head[25] >= 4 and len(head) >= 255
    return legacy or (struct.unpack_from("<Q", head, 247)[0] if is_long else 0)


def _round_up(value: float, step: int) -> int:
    return step * math.ceil(value / step)
