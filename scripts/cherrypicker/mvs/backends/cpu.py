"""Our PatchMatch stereo on the CPU, view after view, a few photos in memory at a time."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from cherrypicker.mvs import estimate
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.lines.line_starts import PhotoLines, find_lines
from cherrypicker.mvs.raster import CLEAR_BELOW, HIDDEN
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.mvs.views import StereoProblem, plan_views
from cherrypicker.mvs.workspace import GEOMETRIC, PHOTOMETRIC, Workspace
from cherrypicker.photos import read_photo
from cherrypicker.progress import Progress

logger = logging.getLogger(__name__)

# Most levels of the pyramid: from the coarsest on, eight pixels are one (guess)
MOST_LEVELS = 4


def run_cpu(
    workspace: Workspace, options: StereoOptions, threads: int, shown: ScanPhotos | None
) -> set[str]:
    """Compute the maps that are not there yet."""
    views = workspace.views
    problems = plan_views(workspace, options.n_sources)
    least = min(min(view.width, view.height) for view in views)
    n_levels = sum(least / 2**n >= options.min_level_px for n in range(1, MOST_LEVELS)) + 1

    # Only as many photos as are in use at a time
    @lru_cache(2 * options.n_sources)
    def pyramid_of(i: int) -> list[np.ndarray]:
        photo = read_photo(workspace.photo_path(views[i]))
        views[i].check_size(photo, workspace.photo_path(views[i]))
        return estimate.pyramid(photo, n_levels)

    @lru_cache(2 * options.n_sources)
    def lines_of(i: int) -> PhotoLines:
        return find_lines(pyramid_of(i)[0])

    logger.info("CPU PatchMatch: %d levels, %d threads", n_levels, threads)

    def photometric(problem: StereoProblem) -> np.ndarray:
        photos = {i: pyramid_of(i) for i in problem.photos}
        lines = {i: lines_of(i) for i in problem.photos}
        skip = None
        if shown is not None:
            raster = shown.raster(problem.view)
            skip = raster == HIDDEN
            if options.use_sky_masks:
                skip |= raster < CLEAR_BELOW
        return estimate.estimate_photometric(problem, views, photos, lines, options, threads, skip)

    _each_view(workspace, problems, PHOTOMETRIC, photometric)

    # A source without a depth map of its own cannot confirm anything
    with_map = {problem.view for problem in problems}
    usable = [replace(p, sources=tuple(j for j in p.sources if j in with_map)) for p in problems]
    usable = [problem for problem in usable if problem.sources]

    def geometric(problem: StereoProblem) -> np.ndarray:
        photos = {i: pyramid_of(i) for i in problem.photos}
        found = {i: workspace.read_depth(views[i], PHOTOMETRIC) for i in problem.photos}
        view = views[problem.view]
        normals = workspace.read_normals(view, PHOTOMETRIC)
        start = estimate.maps_to_field(found[problem.view], normals, view.K)
        depths = {
            i: np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0.0)
            for i, depth in found.items()
        }
        return estimate.estimate_geometric(problem, views, photos, start, depths, options, threads)

    _each_view(workspace, usable, GEOMETRIC, geometric)
    workspace.write_fusion_config()
    return {views[problem.view].name for problem in usable}


def _each_view(
    workspace: Workspace,
    problems: list[StereoProblem],
    kind: str,
    compute: Callable[[StereoProblem], np.ndarray],
) -> None:
    """Compute and write the maps of one kind that are not there yet."""
    views = workspace.views
    due = [p for p in problems if not workspace.has_maps(views[p.view], kind)]
    if len(due) < len(problems):
        logger.info("%d of %d %s maps are there", len(problems) - len(due), len(problems), kind)
    with Progress(len(due), f"{kind} depth maps") as bar:
        for problem in due:
            view = views[problem.view]
            workspace.write_maps(view, kind, *estimate.field_to_maps(compute(problem), view.K))
            bar.step()
