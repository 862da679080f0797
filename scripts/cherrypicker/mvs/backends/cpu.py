"""Our PatchMatch stereo on the CPU, view after view, a few photos in memory at a time."""

from __future__ import annotations

import hashlib
import json
import logging
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import asdict, replace

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

__all__ = ["run_cpu"]

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


class PhotoStore:
    """The undistorted photos as pyramids, only as many as are in use at a time."""

    def __init__(self, workspace: Workspace, n_levels: int, capacity: int):
        self._workspace = workspace
        self._n_levels = n_levels
        self._capacity = capacity
        self._held: OrderedDict[int, list[np.ndarray]] = OrderedDict()
        self._lines: dict[int, PhotoLines] = {}

    def get(self, indices: tuple[int, ...]) -> dict[int, list[np.ndarray]]:
        """Return view index to pyramid for all of ``indices``."""
        for i in indices:
            if i not in self._held:
                view = self._workspace.views[i]
                photo = read_photo(self._workspace.photo_path(view))
                if photo.shape[:2] != (view.height, view.width):
                    raise StageError(
                        f"the undistorted photo is {photo.shape[1]} x {photo.shape[0]} px, its "
                        f"camera {view.width} x {view.height} px",
                        file=self._workspace.photo_path(view),
                    )
                self._held[i] = estimate.pyramid(photo, self._n_levels)
            self._held.move_to_end(i)
        while len(self._held) > max(self._capacity, len(indices)):
            gone, _ = self._held.popitem(last=False)
            self._lines.pop(gone, None)
        return {i: self._held[i] for i in indices}

    def lines(self, indices: tuple[int, ...]) -> dict[int, PhotoLines]:
        """Return view index to the lines of the photo, for ``indices`` that are held."""
        for i in indices:
            if i not in self._lines:
                self._lines[i] = find_lines(self._held[i][0])
        return {i: self._lines[i] for i in indices}


def run_cpu(
    workspace: Workspace, options: StereoOptions, threads: int, sky_masks: SkyMasks | None
) -> set[str]:
    """Compute the maps that are not there yet."""
    views = workspace.views
    problems = plan_views(workspace, options.n_sources)
    sizes = [min(view.width, view.height) for view in views]
    n_levels = estimate.count_levels(min(sizes), min(sizes), options.min_level_px)
    photos = PhotoStore(workspace, n_levels, capacity=2 * options.n_sources)
    keys = MapKeys(workspace)
    digests = _photo_digests(workspace)
    masks = {} if sky_masks is None else {view.name: sky_masks.digest(view) for view in views}
    logger.info("CPU PatchMatch: %d levels, %d threads", n_levels, threads)

    def photometric(problem: StereoProblem) -> np.ndarray:
        indices = (problem.view, *problem.sources)
        held = photos.get(indices)
        skip = None
        if sky_masks is not None:
            skip = clear_sky(held[problem.view][0], sky_masks.of(views[problem.view]))
        lines = photos.lines(indices)
        return estimate.estimate_photometric(problem, views, held, options, threads, skip, lines)

    settings = {
        p.view: _settings(p, options, digests, masks.get(views[p.view].name)) for p in problems
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
        held = photos.get((problem.view, *problem.sources))
        start = _read_field(workspace, views[problem.view])
        depths = {j: _read_inverse_depth(workspace, views[j]) for j in problem.sources}
        return estimate.estimate_geometric(problem, views, held, start, depths, options, threads)

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
    problem: StereoProblem, options: StereoOptions, digests: list[str], mask: str | None
) -> str:
    """Everything that a view's photometric map depends on, as text."""
    content = {
        "version": VERSION,
        "options": {name: getattr(options, name) for name in PHOTOMETRIC_OPTIONS},
        "depth": [problem.depth_min, problem.depth_max],
        "sky_mask": mask,
        "photos": [digests[j] for j in (problem.view, *problem.sources)],
    }
    return json.dumps(content, sort_keys=True)
