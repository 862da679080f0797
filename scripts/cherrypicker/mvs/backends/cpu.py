"""Our PatchMatch stereo on the CPU, view after view, a few photos in memory at a time."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import lru_cache

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.mvs import estimate
from cherrypicker.mvs.backends.map_keys import GEOMETRIC, PHOTOMETRIC, MapKeys
from cherrypicker.mvs.clear_sky import SkyMasks, clear_sky
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.lines.line_starts import PhotoLines, find_lines
from cherrypicker.mvs.views import StereoProblem, plan_views
from cherrypicker.mvs.workspace import View, Workspace
from cherrypicker.photos import read_photo
from cherrypicker.progress import Progress

logger = logging.getLogger(__name__)

# Bump when the CPU backend's results change, so that older maps are computed again
VERSION = 6
# Options that the photometric maps depend on; changing another one keeps them
PHOTOMETRIC_OPTIONS = (
    "n_best",
    "n_iterations",
    "window_radius",
    "min_level_px",
    "color_spread",
    "min_texture",
    "seed",
)


def run_cpu(
    workspace: Workspace, options: StereoOptions, threads: int, sky_masks: SkyMasks | None
) -> set[str]:
    """Compute the maps that are not there yet."""
    views = workspace.views
    problems = plan_views(workspace, options.n_sources)
    sizes = [min(view.width, view.height) for view in views]
    n_levels = estimate.count_levels(min(sizes), min(sizes), options.min_level_px)

    # Only as many photos as are in use at a time
    @lru_cache(2 * options.n_sources)
    def pyramid_of(i: int) -> list[np.ndarray]:
        return estimate.pyramid(_read_photo(workspace, views[i]), n_levels)

    @lru_cache(2 * options.n_sources)
    def lines_of(i: int) -> PhotoLines:
        return find_lines(pyramid_of(i)[0])

    keys = MapKeys(workspace)
    digests = _photo_digests(workspace)
    masks = {} if sky_masks is None else {view.name: sky_masks.digest(view) for view in views}
    logger.info("CPU PatchMatch: %d levels, %d threads", n_levels, threads)

    def photometric(problem: StereoProblem) -> np.ndarray:
        photos = {i: pyramid_of(i) for i in problem.photos}
        lines = {i: lines_of(i) for i in problem.photos}
        skip = None
        if sky_masks is not None:
            sky, hidden = sky_masks.both(views[problem.view])
            skip = clear_sky(photos[problem.view][0], sky) | hidden
        return estimate.estimate_photometric(problem, views, photos, lines, options, threads, skip)

    settings = {
        p.view: _settings(
            p, options, digests, masks.get(views[p.view].name), several=workspace.several
        )
        for p in problems
    }
    _each_view(workspace, problems, keys, settings, PHOTOMETRIC, photometric)

    by_view = {problem.view: problem for problem in problems}
    chained = {
        p.view: json.dumps(
            [asdict(options), settings[p.view]] + [settings[j] for j in p.sources if j in by_view]
        )
        for p in problems
    }
    # A source without a depth map of its own cannot confirm anything
    usable = [replace(p, sources=tuple(j for j in p.sources if j in by_view)) for p in problems]
    usable = [problem for problem in usable if problem.sources]

    def geometric(problem: StereoProblem) -> np.ndarray:
        photos = {i: pyramid_of(i) for i in problem.photos}
        start = _read_field(workspace, views[problem.view])
        depths = {j: _read_inverse_depth(workspace, views[j]) for j in problem.sources}
        return estimate.estimate_geometric(problem, views, photos, start, depths, options, threads)

    _each_view(workspace, usable, keys, chained, GEOMETRIC, geometric)
    workspace.write_fusion_config()
    return {views[problem.view].name for problem in usable}


def _each_view(
    workspace: Workspace,
    problems: list[StereoProblem],
    keys: MapKeys,
    settings: dict[int, str],
    kind: str,
    compute: Callable[[StereoProblem], np.ndarray],
) -> None:
    """Compute and write the maps of one kind that are not there yet."""
    views = workspace.views
    digest = {i: hashlib.sha256(text.encode()).hexdigest() for i, text in settings.items()}
    due = [p for p in problems if not keys.is_current(views[p.view], kind, digest[p.view])]
    if len(due) < len(problems):
        logger.info("%d of %d %s maps are there", len(problems) - len(due), len(problems), kind)
    with Progress(len(due), f"{kind} depth maps") as bar:
        for problem in due:
            view = views[problem.view]
            depth, normals = estimate.field_to_maps(compute(problem), view.K)
            keys.announce(view, kind, digest[problem.view])
            workspace.write_maps(view, kind, depth, normals)
            bar.step()


def _read_photo(workspace: Workspace, view: View) -> np.ndarray:
    photo = read_photo(workspace.photo_path(view))
    view.check_size(photo, workspace.photo_path(view))
    return photo


def _read_field(workspace: Workspace, view: View) -> np.ndarray:
    depth = workspace.read_depth(view, PHOTOMETRIC)
    return estimate.maps_to_field(depth, workspace.read_normals(view, PHOTOMETRIC), view.K)


def _read_inverse_depth(workspace: Workspace, view: View) -> np.ndarray:
    depth = workspace.read_depth(view, PHOTOMETRIC)
    inverse = np.zeros_like(depth)
    np.divide(1.0, depth, out=inverse, where=depth > 0.0)
    return inverse


def _photo_digests(workspace: Workspace) -> list[str]:
    """Digest of every undistorted photo with its camera."""
    digests = []
    for view in workspace.views:
        digest = hashlib.sha256()
        try:
            digest.update(workspace.photo_path(view).read_bytes())
        except FileNotFoundError as error:
            raise StageError(
                "the undistorted photo is missing", file=workspace.photo_path(view)
            ) from error
        for array in (view.K, view.R, view.t):
            digest.update(np.ascontiguousarray(array).tobytes())
        digests.append(digest.hexdigest())
    return digests


def _settings(
    problem: StereoProblem,
    options: StereoOptions,
    digests: list[str],
    mask: str | None,
    *,
    several: bool,
) -> str:
    """Everything that a view's photometric map depends on, as text."""
    content = {
        "version": VERSION,
        "options": {name: getattr(options, name) for name in PHOTOMETRIC_OPTIONS},
        "depth": [problem.depth_min, problem.depth_max],
        "sky_mask": mask,
        "photos": [digests[j] for j in problem.photos],
    }
    if several:  # maps of other scans keep the keys that they have
        content["several"] = True
    return json.dumps(content, sort_keys=True)
