"""Depth maps of a whole workspace with the chosen backend, resuming what is there."""

from __future__ import annotations

import logging
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.mvs.backends.cpu import run_cpu
from cherrypicker.mvs.backends.cuda import run_cuda
from cherrypicker.mvs.backends.map_keys import GEOMETRIC
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.workspace import Workspace

__all__ = ["BACKENDS", "choose_backend", "estimate_workspace"]

logger = logging.getLogger(__name__)

BACKENDS = ("auto", "cuda", "cpu")


def choose_backend(wanted: str) -> str:
    """Return "cuda" or "cpu" for the config's ``mvs.backend``.

    Raises
    ------
    StageError
        If the name is unknown, or CUDA is asked for and this pycolmap has none.
    """
    if wanted not in BACKENDS:
        raise StageError(f"unknown backend {wanted!r}, one of {BACKENDS}", key="mvs.backend")
    if wanted == "cuda" and not pycolmap.has_cuda:
        raise StageError(
            "this pycolmap has no CUDA: run `pip uninstall pycolmap` and "
            f"`pip install pycolmap-cuda12=={pycolmap.__version__}`, or use the CPU backend",
            key="mvs.backend",
        )
    if wanted == "auto":
        return "cuda" if pycolmap.has_cuda else "cpu"
    return wanted


def estimate_workspace(
    folder: str | Path,
    options: StereoOptions,
    *,
    backend: str = "auto",
    threads: int = 1,
    sky_masks: SkyMasks | None = None,
) -> dict:
    """Write photometric and geometric depth and normal maps of every view.

    Whole maps that were made with the same settings, photos and poses are not computed again, nor
    whole maps that another program put there. In memory at a time, whatever the number of photos:
    the photos of ``2 * n_sources`` views (6 bytes a pixel each, pyramid and lines included), the
    packed pixels, the depths and the splatted depths of a reference's sources, and its field.
    On the CPU: 38 ``n_sources`` + 80 bytes per pixel of one photo on top of 190 MB (0.56 GB at 1.2
    megapixels and 6 sources).

    Parameters
    ----------
    folder : path-like
        Dense workspace.
    options : StereoOptions
        Settings.
    backend : {"auto", "cuda", "cpu"}
        See :func:`choose_backend`.
    threads : int
        Threads of the CPU backend.
    sky_masks : SkyMasks, optional
        The CPU backend leaves out what they call sky, see :mod:`cherrypicker.mvs.clear_sky`.

    Returns
    -------
    dict
        The manifest: backend, options, names with a depth map, share of pixels with depth.
    """
    workspace = Workspace(folder)
    chosen = choose_backend(backend)
    names, shares = set(), {}
    if chosen == "cuda":
        names = run_cuda(workspace, options)
        shares = _shares_with_depth(workspace, names)
        if backend == "auto" and not any(shares.values()):
            logger.warning(
                "COLMAP's CUDA stereo left all %d depth maps empty, as on some GPUs (COLMAP "
                "issue 4090): the CPU computes them instead",
                len(names),
            )
            for view in workspace.views:
                workspace.remove_maps(view)
            chosen = "cpu"
    if chosen == "cpu":
        names = run_cpu(workspace, options, threads, sky_masks)
        shares = _shares_with_depth(workspace, names)
    share = float(np.mean(list(shares.values()))) if shares else 0.0
    logger.info("%s backend: depth at %.1f %% of the pixels", chosen, 100.0 * share)
    if share == 0.0:
        raise StageError(
            "no pixel has a consistent depth in any photo",
            file=Path(folder),
            key="mvs.backend" if chosen == "cuda" else "mvs.max_cost, mvs.min_consistent",
        )
    return {
        "backend": chosen,
        "options": asdict(options),
        "maps": list(shares),
        "share_with_depth": shares,
    }


def _shares_with_depth(workspace: Workspace, names: set[str]) -> dict[str, float]:
    """Return the share of the pixels with a depth, for each of some photos."""
    return {
        view.name: float((workspace.read_depth(view, GEOMETRIC) > 0).mean())
        for view in workspace.views
        if view.name in names
    }
