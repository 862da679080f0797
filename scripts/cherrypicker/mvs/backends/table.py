"""The backends of dense stereo, once: what runs, what it needs, what it costs, which comes first.

A new backend is a row of `BACKENDS` (and a name that the config's schema allows). Nothing heavy is
imported before it runs: the forecast and the rules' resources read this table as well.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

AUTO = "auto"


@dataclass(frozen=True)
class Backend:
    """A program that computes depth maps."""

    title: str  # its name on pages
    # Takes a `Workspace`, `StereoOptions`, the number of threads and the `ScanPhotos` of the
    # workspace or None; writes its geometric depth and normal maps, and COLMAP's config of their
    # fusion; returns the names of the photos that have maps
    run: Callable[..., set[str]]
    # cpu_s, memory_mb: what the stage costs with it, see `batch/stage_costs.yaml`
    cpu_s: str = ""
    memory_mb: str = ""
    max_threads: int = 8  # threads beyond which it gains nothing
    needs_cuda: bool = False  # it runs where `has_cuda`, on a GPU
    cause: str = "mvs.backend"  # config keys to change when it leaves all maps empty


def has_cuda() -> bool:
    """Whether the installed pycolmap was built with CUDA; the one place that decides it."""
    try:
        import pycolmap
    except ImportError:  # as where Snakemake alone is installed
        return False
    return bool(pycolmap.has_cuda)


def first_choice(wanted: str, with_cuda: bool | None = None) -> str:
    """Return the backend of the config's ``mvs.backend``: for ``auto`` the first that can run.

    `has_cuda` tells whether there is CUDA where `with_cuda` is left out.
    """
    if wanted != AUTO:
        return wanted
    with_cuda = has_cuda() if with_cuda is None else with_cuda
    return next(name for name, backend in BACKENDS.items() if with_cuda or not backend.needs_cuda)


def _cuda(*work: Any) -> set[str]:
    from cherrypicker.mvs.backends.cuda import run_cuda

    return run_cuda(*work)


def _cpu(*work: Any) -> set[str]:
    from cherrypicker.mvs.backends.cpu import run_cpu

    return run_cpu(*work)


#: Name in the config to backend; ``auto`` takes the first that can run.
BACKENDS = {
    "cuda": Backend(
        "CUDA (COLMAP)",
        _cuda,
        # A data-centre GPU was not at hand: the rate is assumed, nothing was measured. What the
        # CPU does beside it is reading and writing
        cpu_s="20 + 0.25 sources dense_mp",
        memory_mb="1500 + 76 sources largest_dense_mp + 160 largest_dense_mp",
        max_threads=2,
        needs_cuda=True,
    ),
    "cpu": Backend(
        "CPU (ours)",
        _cpu,
        # A second a megapixel and source. Where a third of the photo is sky, which is left out, the
        # kernels take 4.3 to 4.8 with six sources, and the stage took 5.7 on a machine with other
        # jobs. It holds 38 bytes a pixel for each source and 100 for the photo itself
        cpu_s="10 + sources dense_mp",
        memory_mb="260 + 38 sources largest_dense_mp + 100 largest_dense_mp",
        cause="mvs.max_image_size_px",
    ),
}
