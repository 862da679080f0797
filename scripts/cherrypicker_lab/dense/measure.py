"""One run of dense stereo, measured: processor time, memory, agreement with the sparse model.

Meant for a process of its own, whose peak memory is then that of the run.
"""

from __future__ import annotations

import logging
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.mvs.backends.choice import estimate_workspace, run_backend
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.fusion import FusionOptions, fuse_workspace
from cherrypicker.mvs.workspace import Workspace
from cherrypicker.pointcloud import PointCloud
from cherrypicker_lab.dense.agreement import sparse_agreement
from cherrypicker_lab.dense.backends import ALL_BACKENDS, WITH_SKY_MASKS, backends_here
from cherrypicker_lab.dense.copies import copy_workspace

logger = logging.getLogger(__name__)

# A few small photos with two pyramid levels reach every kernel
_WARM_UP = {"megapixels": 0.12, "max_photos": 4}


def measure_stereo(
    source: str | os.PathLike,
    folder: str | os.PathLike,
    backend: str,
    stereo: StereoOptions,
    fusion: FusionOptions,
    *,
    megapixels: float | None = None,
    max_photos: int | None = None,
    sky: tuple | None = None,
    threads: int = 1,
) -> tuple[dict, PointCloud]:
    """Estimate depth maps in a copy of a workspace, fuse them, and measure both.

    Compiled kernels are made by another process before and loaded by a run on four small photos, so
    that neither their time nor their compiler's memory counts; ``warm_up_cpu_s`` is the time of the
    latter. Maps that the folder holds are removed.

    Parameters
    ----------
    source : path-like
        Dense workspace, left as it is.
    folder : path-like
        Copy to make; its maps are kept.
    backend : str
        A name of `cherrypicker_lab.dense.backends.ALL_BACKENDS`.
    stereo : StereoOptions
        Of the cpu and the cuda backend; the source views of all.
    fusion : FusionOptions
        The same for all backends.
    megapixels, max_photos : optional
        See :func:`cherrypicker_lab.dense.copies.copy_workspace`.
    sky : tuple of path-like, optional
        Folder of sky masks, and of the sparse model of the photos as stored, for the backends that
        leave the sky out (cpu, sgbm_sky).

    Returns
    -------
    report : dict
        ``cpu_s``, ``wall_s`` and ``peak_mb`` under ``depth`` and ``fusion`` (peaks since the
        process began), ``megapixels`` of all references, ``cpu_s_per_megapixel``, ``agreement``,
        ``share_with_depth``, ``n_points`` and what it ran on.
    cloud : PointCloud
        In the workspace's frame.

    Raises
    ------
    StageError
        If the backend is unknown or cannot run here.
    """
    if backend not in backends_here():
        raise StageError(
            f"backend {backend!r} cannot run here, only {', '.join(backends_here())}",
            key="benchmark.backends",
        )
    copy_workspace(source, folder, megapixels=megapixels, max_photos=max_photos)
    warm_up_s = _warm_up(source, stereo, threads) if backend == "cpu" else 0.0
    workspace = Workspace(folder)
    views = workspace.views
    masks = None
    if sky is not None and backend in WITH_SKY_MASKS:
        masks = SkyMasks(*sky, [view.name for view in views])
    program = ALL_BACKENDS[backend]
    shares, depth_use = _measured(lambda: run_backend(program, workspace, stereo, threads, masks))
    if not any(shares.values()):
        raise StageError("no photo has a depth", file=Path(folder), key=program.cause)
    cloud, fusion_use = _measured(
        lambda: fuse_workspace(workspace, list(shares), fusion, threads=threads)
    )
    total = sum(view.width * view.height for view in views) / 1e6
    report = {
        "backend": backend,
        "n_photos": len(views),
        "n_maps": len(shares),
        "megapixels": total,
        "megapixels_per_photo": total / len(views),
        "depth": depth_use,
        "fusion": fusion_use,
        "cpu_s_per_megapixel": depth_use["cpu_s"] / total,
        "wall_s_per_megapixel": depth_use["wall_s"] / total,
        "fusion_cpu_s_per_megapixel": fusion_use["cpu_s"] / total,
        "warm_up_cpu_s": warm_up_s,
        "left_out_sky": masks is not None,
        "agreement": sparse_agreement(folder),
        "share_with_depth": float(np.mean(list(shares.values()))),
        "n_points": len(cloud),
        "stereo_options": asdict(stereo),
        "fusion_options": asdict(fusion),
        "threads": threads,
        "processor": _processor(),
        "pycolmap": pycolmap.__version__,
    }
    logger.info(
        "%s: %.1f CPU s a megapixel, %.0f MB, %.1f %% of the sparse points agree, %s points",
        backend,
        report["cpu_s_per_megapixel"],
        depth_use["peak_mb"],
        100 * report["agreement"]["share"],
        f"{len(cloud):,}",
    )
    return report, cloud


def _measured(work: Callable):
    """Return what ``work`` returns and its use of processor (all threads), clock and memory."""
    cpu, wall = _cpu_seconds(), time.perf_counter()
    result = work()
    use = {
        "cpu_s": _cpu_seconds() - cpu,
        "wall_s": time.perf_counter() - wall,
        "peak_mb": _peak_mb(),
    }
    return result, use


def _cpu_seconds() -> float:
    """User and system time of this process, its threads and its finished children, seconds."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _peak_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if platform.system() == "Darwin" else 2**10)


def _warm_up(source, stereo: StereoOptions, threads: int) -> float:
    """Compile in another process, load in this one; return the CPU seconds of the latter."""
    with tempfile.TemporaryDirectory() as scratch:
        small = Path(scratch) / "small"
        area = min(view.width * view.height for view in Workspace(source).views) / 1e6
        copy_workspace(
            source,
            small,
            megapixels=min(_WARM_UP["megapixels"], area),
            max_photos=_WARM_UP["max_photos"],
        )
        library = Path(__file__).resolve().parents[2]
        code = f"from {__name__} import warm_up; warm_up({str(small)!r})"
        environment = {**os.environ, "PYTHONPATH": str(library)}
        subprocess.run([sys.executable, "-c", code], env=environment, check=True)
        start = _cpu_seconds()
        warm_up(small, stereo, threads)
        return _cpu_seconds() - start


def warm_up(folder: str | os.PathLike, stereo: StereoOptions | None = None, threads: int = 1):
    """Run stereo and fusion on a small workspace for their kernels' sake."""
    for part in ("depth_maps", "normal_maps"):
        for path in (Path(folder) / "stereo" / part).glob("*"):
            path.unlink()
    try:
        manifest = estimate_workspace(
            folder, stereo or StereoOptions(), backend="cpu", threads=threads
        )
        options = FusionOptions(min_views=2)
        fuse_workspace(Workspace(folder), manifest["maps"], options, threads=threads)
    except StageError as error:  # so few and small photos may agree on nothing
        logger.info("warm-up: %s", error.describe())


def _processor() -> str:
    """Name of the processor, as far as the system tells."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
