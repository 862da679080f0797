"""Depth maps of a whole workspace with the chosen backend, resuming what is there."""

import hashlib
import json
import logging
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.mvs.backends.table import AUTO, BACKENDS, first_choice, has_cuda
from cherrypicker.mvs.depth_rasters import write_depth_raster
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.mvs.workspace import GEOMETRIC, Workspace

logger = logging.getLogger(__name__)

# Bump when a backend's results change, so that what a killed run left is not taken up
VERSION = 7


def estimate_workspace(
    folder: str | Path,
    options: StereoOptions,
    *,
    several: bool = False,
    backend: str = AUTO,
    threads: int = 1,
    evidence: Path | None = None,
    depth: Path | None = None,
) -> dict:
    """Write photometric and geometric depth and normal maps of every view.

    Whole maps that were made with the same settings, photos, model and evidence are not computed
    again, nor whole maps that another program put there.

    In memory at a time, whatever the number of photos: the photos of ``2 * n_sources`` views (7
    bytes a pixel each, pyramid and lines included), the packed pixels, the depths and the splatted
    depths of a reference's sources, and its field.
    On the CPU: 38 ``n_sources`` + 80 bytes per pixel of one photo on top of 190 MB (0.56 GB at 1.2
    megapixels and 6 sources).

    The scan may be of several trees. The backend is a name of `BACKENDS`; ``auto`` takes the first
    that can run, and where all its maps come out empty the CPU. By the folder ``evidence`` of what
    each photo shows (:mod:`cherrypicker.mvs.raster`) what a user hides gets no depth, nor, on the
    CPU, clear sky. The folder ``depth`` takes the geometric depths as a small raster a photo, too.
    Returns the manifest: backend, options, names with a depth map, share of pixels with depth.

    Raises
    ------
    StageError
        If CUDA is asked for and this pycolmap has none, or if no pixel gets a depth.
    """
    chosen = first_choice(backend)
    if BACKENDS[chosen].needs_cuda and not has_cuda():
        raise StageError(
            "this pycolmap has no CUDA: run `pip uninstall pycolmap` and "
            f"`pip install pycolmap-cuda12=={pycolmap.__version__}`, or use the CPU backend",
            key="mvs.backend",
        )
    workspace = Workspace(folder, several=several)
    workspace.keep_maps_of(_digest(workspace, chosen, options, evidence))
    shown = ScanPhotos(workspace.poses, evidence) if evidence else None
    made = BACKENDS[chosen].run(workspace, options, threads, shown)
    shares = {}
    for view in (view for view in workspace.views if view.name in made):
        found = workspace.read_depth(view, GEOMETRIC)
        shares[view.name] = float((found > 0).mean())
        if depth and shares[view.name]:  # CUDA may leave all maps empty
            write_depth_raster(depth, view.name, found)
    if backend == AUTO and BACKENDS[chosen].needs_cuda and not any(shares.values()):
        logger.warning(
            f"COLMAP's CUDA stereo left all {len(shares)} depth maps empty, as on some GPUs "
            "(COLMAP issue 4090): the CPU computes them instead"
        )
        return estimate_workspace(
            folder,
            options,
            several=several,
            backend=first_choice(AUTO, with_cuda=False),
            threads=threads,
            evidence=evidence,
            depth=depth,
        )
    share = float(np.mean(list(shares.values()))) if shares else 0.0
    logger.info("%s backend: depth at %.1f %% of the pixels", chosen, 100.0 * share)
    if share == 0.0:
        raise StageError(
            "no pixel has a consistent depth in any photo",
            file=Path(folder),
            key=BACKENDS[chosen].cause,
        )
    return {
        "backend": chosen,
        "options": asdict(options),
        "maps": list(shares),
        "share_with_depth": shares,
    }


def estimate_apart(folder: Path, *args: Any, **options: Any) -> dict:
    """Write the maps of a workspace with ``images`` and ``sparse`` when all are made.

    They are made in ``.stereo`` beside ``stereo``: a killed run leaves nothing under the final
    name, and the next takes up what is whole. The rest is as of :func:`estimate_workspace`.
    """
    apart = folder / ".stereo"
    for name in ("depth_maps", "normal_maps", "consistency_graphs"):  # COLMAP makes none of them
        (apart / "stereo" / name).mkdir(parents=True, exist_ok=True)
    for name in ("images", "sparse"):
        link = apart / name
        link.unlink(missing_ok=True)
        link.symlink_to(Path("..") / name)
    manifest = estimate_workspace(apart, *args, **options)
    shutil.rmtree(folder / "stereo", ignore_errors=True)
    (apart / "stereo").rename(folder / "stereo")
    shutil.rmtree(apart)
    return manifest


def _digest(workspace: Workspace, name: str, options: StereoOptions, evidence: Path | None) -> str:
    """Return what tells maps of these settings, photos, model and evidence from others."""
    settings = json.dumps([VERSION, name, asdict(options), workspace.several])
    digest = hashlib.sha256(settings.encode())
    try:
        images = [workspace.photo_path(view) for view in workspace.views]
        rasters = sorted(evidence.iterdir()) if evidence else []
        for path in [*sorted((workspace.folder / "sparse").iterdir()), *images, *rasters]:
            digest.update(path.read_bytes())
    except FileNotFoundError as error:
        raise StageError(
            "an undistorted photo, or what it shows, is missing", file=error.filename
        ) from error
    return digest.hexdigest()
