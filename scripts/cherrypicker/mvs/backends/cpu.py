"""Our PatchMatch stereo on the CPU, view after view."""

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cherrypicker.mvs.estimate import Stereo, StereoOptions, field_to_maps
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.mvs.views import StereoProblem, plan_views
from cherrypicker.mvs.workspace import GEOMETRIC, PHOTOMETRIC, Workspace
from cherrypicker.progress import Progress

logger = logging.getLogger(__name__)


def run_cpu(
    workspace: Workspace, options: StereoOptions, threads: int, shown: ScanPhotos | None
) -> set[str]:
    """Compute the maps that are not there yet."""
    problems = plan_views(workspace, options.n_sources)
    stereo = Stereo(workspace, options, threads, shown)
    logger.info("CPU PatchMatch: %d levels, %d threads", stereo.n_levels, threads)
    _each_view(workspace, problems, PHOTOMETRIC, stereo.photometric)
    # A source without a depth map of its own cannot confirm anything
    with_map = {problem.view for problem in problems}
    usable = [replace(p, sources=tuple(j for j in p.sources if j in with_map)) for p in problems]
    usable = [problem for problem in usable if problem.sources]
    _each_view(workspace, usable, GEOMETRIC, stereo.geometric)
    workspace.write_fusion_config()
    return {workspace.views[problem.view].name for problem in usable}


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
            workspace.write_maps(view, kind, *field_to_maps(compute(problem), view.K))
            bar.step()
