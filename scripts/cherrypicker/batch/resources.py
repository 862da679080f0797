"""Threads, memory and running time to ask for, from the size of a scan.

The size comes from the headers of the photos or of the ready cloud and from the config, so that it
is known before anything is run. What each stage costs stands in ``stage_costs.yaml``.
"""

import math
import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cherrypicker.files import load_yaml
from cherrypicker.mvs.backends.table import BACKENDS, first_choice
from cherrypicker.ply import PlyError, read_ply_header
from cherrypicker.sfm.pairs import N_ALIKE, N_PARTNERS
from cherrypicker.sfm.photo_files import PLAIN_FIRST_MP, megapixels

# Snakemake itself and the job's shell run beside the stage and count towards its memory
SNAKEMAKE_MB = 250
# On the formula's peak memory and CPU time: other scans, slower nodes, a busy file system
MEMORY_MARGIN = 1.3
TIME_MARGIN = 4.0
# Start of Python, of Snakemake and of compiled kernels on a node that has none cached yet
START_MINUTES = 5
# A thread is worth asking for from this much work on
CPU_S_PER_THREAD = 120.0
# Points of the cloud per pixel of all depth maps: 0.013 to 0.017 were measured on 48 to 86 photos;
# this leaves room. At most, where bare ground keeps its points: 0.048 to 0.099, and 0.19 on the
# rehearsal's 250 photos
POINTS_PER_PIXEL = 0.03
MOST_POINTS_PER_PIXEL = 0.20
# What the crop leaves of a cloud with all of its points, at most; of others 0.8 to 0.9, nearly all
MOST_CROPPED_SHARE = 0.5


@dataclass(frozen=True)
class StageCost:
    """A row of ``stage_costs.yaml``: of which scans, and formulas of :class:`ScanSize`'s fields."""

    of: str = ""
    cpu_s: str = ""
    memory_mb: str = ""
    thread_memory_mb: str = ""
    disk_mb: str = ""
    max_threads: int = 1


# Keys that ask for a stage which not every tree gets, by the kind of scan that this makes
ASKED_BY = {"light": "enabled", "bearing": "enabled", "pruning": "preset"}
_PREPARED = "prepared photos"

STAGES = {
    rule: StageCost(**cells)
    for rule, cells in load_yaml(Path(__file__).with_name("stage_costs.yaml")).items()
}


@dataclass(frozen=True)
class ScanSize:
    """How large a scan is, as far as its cost goes: what the formulas of the costs name."""

    kinds: tuple[str, ...] = ("clouds", "unlabelled")  # of scans, as `StageCost.of` has them
    stereo: str = "cpu"  # the backend of its depth maps
    photos: int = 0
    pairs: int = 0  # of photos to match
    # Megapixels of all photos: as they are, as features are sought with photos that are enlarged
    # for it counted four times, as depth is estimated, and those whose maps stay on disk
    photo_mp: float = 0.0
    sift_mp: float = 0.0
    dense_mp: float = 0.0
    kept_mp: float = 0.0
    # Of the largest photo: as it is, as features are sought, and as depth is estimated
    largest_photo_mp: float = 0.0
    largest_feature_mp: float = 0.0
    largest_dense_mp: float = 0.0
    # Other photos that a depth map is made from, and those that it is checked against
    sources: int = 0
    checked: int = 0
    # Millions of points to expect; as many as memory must suffice for, in the cloud and after the
    # crop
    points_m: float = 0.0
    most_points_m: float = 0.0
    most_cropped_m: float = 0.0

    @property
    def is_prepared(self) -> bool:
        """Whether stages read prepared photos."""
        return _PREPARED in self.kinds

    @property
    def stages(self) -> list[str]:
        """The stages that a scan like this goes through, in their order."""
        return [rule for rule, stage in STAGES.items() if stage.of in ("", *self.kinds)]

    def cost(self, rule: str) -> StageCost:
        """Return what a stage costs, the stereo with the scan's backend."""
        if rule != "estimate_depth":
            return STAGES[rule]
        own = BACKENDS[self.stereo]
        return replace(
            STAGES[rule], cpu_s=own.cpu_s, memory_mb=own.memory_mb, max_threads=own.max_threads
        )

    def cpu_s(self, rule: str) -> float:
        """Return the CPU time to expect of a stage, seconds."""
        return _value(self.cost(rule).cpu_s, vars(self))

    def memory_mb(self, rule: str, threads: int = 1) -> float:
        """Return the peak resident memory to expect of a stage, MB, without any margin."""
        stage, known = self.cost(rule), vars(self)
        return _value(stage.memory_mb, known) + threads * _value(stage.thread_memory_mb, known)

    def disk_mb(self, rule: str) -> float:
        """Return what a stage leaves on disk, MB."""
        return _value(self.cost(rule).disk_mb, vars(self))


def _value(formula: str, known: Mapping[str, float]) -> float:
    """The value of a sum of products of numbers and known names; 0 of an empty one."""
    terms = [term.split() for term in formula.split(" + ")] if formula else []
    return sum(math.prod(known[at] if at in known else float(at) for at in term) for term in terms)


def size_of_photos(
    sizes: Sequence[tuple[int, int]], settings: Mapping, *, is_prepared: bool = False
) -> ScanSize:
    """Return the size of a scan by its photos' widths and heights, px, and its whole config.

    ``is_prepared`` tells whether stages read prepared photos.
    """
    sfm, mvs = settings["sfm"], settings["mvs"]
    limit_px = settings["photos"]["max_size_px"] or math.inf  # 0: as it is
    features_px = min(sfm["max_image_size_px"] or math.inf, limit_px)
    as_is, features, dense = (
        [megapixels(*size, limit) for size in sizes]
        for limit in (limit_px, features_px, mvs["max_image_size_px"])
    )
    dense_mp, n_others = sum(dense), max(len(sizes) - 1, 1)
    most_points_m = MOST_POINTS_PER_PIXEL * dense_mp
    kinds = ["photos", "unlabelled", *asked_for(settings)] + [_PREPARED] * is_prepared
    return ScanSize(
        kinds=tuple(kinds),
        stereo=first_choice(mvs["backend"]),
        photos=len(sizes),
        pairs=count_pairs(len(sizes), sfm),
        photo_mp=sum(as_is),
        sift_mp=sum(mp if mp >= PLAIN_FIRST_MP else 4.0 * mp for mp in features),
        dense_mp=dense_mp,
        kept_mp=dense_mp if settings["keep"]["dense"] else 0.0,
        largest_photo_mp=max(as_is, default=0.0),
        largest_feature_mp=max(features, default=0.0),
        largest_dense_mp=max(dense, default=0.0),
        sources=min(mvs["n_sources"], n_others),
        checked=min(mvs["n_check"], n_others),
        points_m=POINTS_PER_PIXEL * dense_mp,
        most_points_m=most_points_m,
        most_cropped_m=MOST_CROPPED_SHARE * most_points_m,
    )


def asked_for(settings: Mapping) -> list[str]:
    """Return what a tree's whole config asks for that not every tree gets."""
    return [kind for kind, key in ASKED_BY.items() if settings[kind][key]]


def count_points(path: str | os.PathLike) -> int:
    """Return the number of points of a PLY or LAS/LAZ file from its header.

    Text files are estimated from their length and their first lines; a missing or broken file has
    none.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    try:
        if suffix == ".ply":
            _, elements, _, _ = read_ply_header(path)
            return max(0, sum(one.count for one in elements if one.name == "vertex"))
        with open(path, "rb") as stream:
            head = stream.read(4096)
        if suffix not in (".las", ".laz"):
            return path.stat().st_size * head.count(b"\n") // max(len(head), 1)
        # By hand: laspy reads as many records as a broken header says, before every run
        if not head.startswith(b"LASF"):
            return 0
        (legacy,) = struct.unpack_from("<I", head, 107)
        is_long = head[25] >= 4 and len(head) >= 255
        return legacy or (struct.unpack_from("<Q", head, 247)[0] if is_long else 0)
    except (OSError, PlyError, struct.error):
        return 0


def count_pairs(n_photos: int, sfm: Mapping) -> int:
    """Return how many pairs of photos are matched, at most, by the config's section ``sfm``."""
    all_pairs = n_photos * (n_photos - 1) // 2
    if n_photos <= sfm["exhaustive_max_photos"]:
        return all_pairs
    return min(all_pairs, n_photos * (N_ALIKE + N_PARTNERS))


def threads_to_ask(rule: str, scan: ScanSize) -> int:
    """Return how many threads are worth asking for: two minutes of work each, up to the bound."""
    wanted = math.ceil(scan.cpu_s(rule) / CPU_S_PER_THREAD)
    return max(1, min(scan.cost(rule).max_threads, wanted))


def mb_to_ask(rule: str, scan: ScanSize, threads: int = 1, attempt: int = 1) -> int:
    """Return the memory to ask for: formula and margin, times the attempt; MB, in hundreds."""
    peak = scan.memory_mb(rule, threads)
    return 100 * math.ceil(attempt * (SNAKEMAKE_MB + MEMORY_MARGIN * peak) / 100)


def minutes_to_ask(rule: str, scan: ScanSize, threads: int = 1, attempt: int = 1) -> int:
    """Return the time to ask for: formula and margin, times the attempt; minutes, in fives."""
    busy_s = scan.cpu_s(rule) / threads
    return 5 * math.ceil(attempt * (START_MINUTES + TIME_MARGIN * busy_s / 60.0) / 5)
