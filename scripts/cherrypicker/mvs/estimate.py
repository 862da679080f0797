"""Depth and normals of one view, coarse to fine (photometric), then with its sources' maps."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from cherrypicker.mvs.kernels import consistency, initial, patchmatch
from cherrypicker.mvs.kernels.bend import find_bend
from cherrypicker.mvs.kernels.level import Level, State
from cherrypicker.mvs.kernels.matching import (
    INVALID_COST,
    noise_variance,
    pack_bilinear,
    pack_color,
    window,
)
from cherrypicker.mvs.kernels.patchmatch import HOPELESS_COST, Turn
from cherrypicker.mvs.kernels.projection import relative_projection
from cherrypicker.mvs.lines.line_starts import PhotoLines, find_lines, start_from_lines
from cherrypicker.mvs.raster import CLEAR_BELOW, HIDDEN
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.mvs.views import StereoProblem
from cherrypicker.mvs.workspace import PHOTOMETRIC, Workspace
from cherrypicker.photos import read_photo
from cherrypicker.placement.region import Region
from cherrypicker.poses import View

# A pixel of a level is left out where more of it shows clear sky: all but what rounding leaves
NOTHING_BUT_SKY = 0.999
# What a sweep tries at the coarsest level, at those between, first and further ones, and at full
# size. Only the coarsest draws depths from the whole range: where that is hundreds of pixels of
# parallax a draw hits nothing, or something wrong (without them one in fifteen of the misses of
# wood of 10 mm and more is gone, and a tenth of the time, foreign_a)
COARSEST_TURN = Turn(8, 4, n_random=2)
FIRST_TURN = Turn(6, 3)
FURTHER_TURN = Turn(4, 2)
# At full size a pixel that costs more than 0.65 is not refined: few of them recover, and they are a
# third
FULL_TURN = Turn(4, 1, refine_below=np.float32(0.65))
# The same where the cost holds the geometric error too
CONSISTENT_TURN = Turn(4, 2, refine_below=HOPELESS_COST)
# What one pixel of disagreement with a source's depth map adds to 1 - NCC. With COLMAP's 0.3 F1 of
# two scans moves by 0.003 at most, of wood below 10 mm of radius by 0.006
GEOMETRIC_WEIGHT = 0.2
# Least number of sources that must confirm a depth, and the reprojection error, px, up to which one
# does: with COLMAP's 1 F1 at 10 mm of wood below 5 mm of radius falls by 0.005 and 0.012 on two
# scans
MIN_CONSISTENT = pycolmap.PatchMatchOptions().filter_min_num_consistent
MOST_ERROR_PX = 1.5
# Its largest 1 - NCC; with COLMAP's 0.9 F1 at 10 mm falls by 0.007 and 0.016 on two scans
MOST_COST = 0.7
# Sweeps of the coarsest level beyond ``n_iterations`` (guess)
MORE_SWEEPS = 2
# Seeds of the sweeps of a photo lie so many bits apart, above all counts of pixels and their draws
SWEEP_BITS = 40
# Share of the region's radius within which lines are looked for: a crown is narrower than the walk
# around it (0.5 and 0.8 find as much)
CROWN_REACH = 0.6
# Pixels around a started line that are refined with it: a twig is wider than its line
LINE_REACH = 2
# How far around a pixel a coarser level must have found nothing but what lies beyond the region, px
# of that level: a branch of that width is seen there
BEYOND_MARGIN = 1


@dataclass(frozen=True)
class StereoOptions:
    """What the CPU backend does.

    ``n_sources``, ``n_iterations`` and ``seed`` are config keys of the section ``mvs``.
    """

    n_sources: int = 6
    n_iterations: int = 1
    seed: int = 0
    min_level_px: int = 120  # least shorter side of the pyramid's coarsest level
    # Of the patch, px. With 2 F1 at 5 mm of an apple with spurs is 0.889 for 0.891, of a phone's
    # photos 0.922 for 0.941; with 4 (and a `min_texture` of 3) 0.892 for 0.905, 0.947 for 0.940
    window_radius: int = 3
    # How many of the sources, the best at each pixel, make its cost. With 2 the same are 0.888 for
    # 0.892 and 0.931 for 0.941
    n_best: int = 3
    # Most colour distance, grey levels, at which a pixel of a patch counts half, in noisy photos
    color_spread: float = 16.0
    # Least standard deviation of a patch, grey levels; what has less gets no depth. With 3 the same
    # 0.905 for 0.892 and 0.940 for 0.941, of a spindle 0.967 for 0.967, but tips of the three 149,
    # 211 and 333 for 152, 206 and 338 of 200, 209 and 338 (all 2026-11-30)
    min_texture: float = 1.5


def view_seed(seed: int, name: str, stage: int) -> int:
    """Return a 48-bit seed of one photo and stage."""
    text = f"{seed}:{name}:{stage}".encode()
    return int.from_bytes(hashlib.sha256(text).digest()[:6], "little")


class Stereo:
    """PatchMatch on the photos of a workspace, of which only as many are held as are in use.

    What a user hides, by what the photos have ``shown``, is not matched, nor clear sky.
    """

    def __init__(
        self,
        workspace: Workspace,
        options: StereoOptions,
        threads: int = 1,
        shown: ScanPhotos | None = None,
    ):
        self.workspace, self.views = workspace, workspace.views
        self.options, self.threads, self.shown = options, threads, shown
        least = min(min(view.width, view.height) for view in self.views)
        self.n_levels = max((least // options.min_level_px).bit_length(), 1)
        in_use = lru_cache(2 * options.n_sources)
        self.pyramid = in_use(self._pyramid)
        self.lines: Callable[[int], PhotoLines] = in_use(lambda i: find_lines(self.pyramid(i)[0]))

    def _pyramid(self, i: int) -> list[np.ndarray]:
        """A photo (height, width, 3), finest first, and its halves by averaging."""
        path = self.workspace.photo_path(self.views[i])
        levels = [read_photo(path)]
        self.views[i].check_size(levels[0], path)
        for _ in range(self.n_levels - 1):
            height, width = levels[-1].shape[:2]
            size = (max(width // 2, 1), max(height // 2, 1))
            levels.append(cv2.resize(levels[-1], size, interpolation=cv2.INTER_AREA))
        return levels

    def level(
        self, problem: StereoProblem, index: int, depths: list[np.ndarray] | None = None
    ) -> Level:
        """Gather what the kernels need for one reference at one pyramid level, 0 the finest.

        ``depths`` are the sources' depth maps at level 0, 0 where unknown; without them consistency
        costs nothing.
        """
        options, views = self.options, self.views
        photo = self.pyramid(problem.view)[index]
        height, width = photo.shape[:2]
        reference = views[problem.view]
        pose = reference.kernel_camera(width, height)
        K = pose[0]
        sources = [self.pyramid(j)[index] for j in problem.sources]
        sizes = [source.shape[1::-1] for source in sources]
        others = [views[j].kernel_camera(*size) for j, size in zip(problem.sources, sizes)]
        starts = np.cumsum([0, *(width * height for width, height in sizes[:-1])])
        packed = [pack_bilinear(cv2.cvtColor(source, cv2.COLOR_RGB2GRAY)) for source in sources]
        maps = [np.zeros(1, dtype=np.float32)] if depths is None else depths
        inverse = [np.divide(1.0, each, out=np.zeros_like(each), where=each > 0.0) for each in maps]
        samples = window(options.window_radius)
        return Level(
            color=pack_color(photo),
            width=width,
            height=height,
            samples=samples,
            offsets=(samples[1] * width + samples[0]).astype(np.int64),
            radius=np.float32(options.window_radius),
            # What noise makes of a squared distance: three channels, of two pixels each
            inv_color=np.float32(1.0 / min(6.0 * noise_variance(photo), options.color_spread**2)),
            packed=np.concatenate(packed),
            layout=np.array([(start, *size) for start, size in zip(starts, sizes)], dtype=np.int64),
            project=np.array([relative_projection(pose, other) for other in others], np.float32),
            depth=np.concatenate([each.ravel() for each in inverse]),
            back=np.array([relative_projection(other, pose) for other in others], np.float32),
            n_best=min(options.n_best, len(problem.sources)),
            geometric_weight=np.float32(0.0 if depths is None else GEOMETRIC_WEIGHT),
            w_min=np.float32(1.0 / problem.depth_max),
            w_max=np.float32(1.0 / problem.depth_min),
            w_px=np.float32(reference.K[0, 0] / (K[0, 0] * problem.depth_max)),
            fx=np.float32(K[0, 0]),
            fy=np.float32(K[1, 1]),
            cx=np.float32(K[0, 2]),
            cy=np.float32(K[1, 2]),
            bend=np.zeros((0, 0, 3), np.float32),
        )

    def photometric(self, problem: StereoProblem) -> np.ndarray:
        """Match a reference against its sources, coarse to fine, to the field at full size.

        That is (height, width, 4), float32: inverse depth (0 where skipped or without texture),
        slopes, cost.
        """
        options, threads, region = self.options, self.threads, self.workspace.region
        view = self.views[problem.view]
        seed = view_seed(options.seed, view.name, 0)
        skip = np.zeros((view.height, view.width), dtype=bool)
        if self.shown is not None:
            raster = self.shown.raster(problem.view)
            skip = (raster == HIDDEN) | (raster < CLEAR_BELOW)
        coarse: State | None = None
        coarse_color = None
        n_swept = 0
        for index in reversed(range(self.n_levels)):
            level = self.level(problem, index)
            size = (level.width, level.height)
            skipped = cv2.resize(skip.astype(np.float32), size, interpolation=cv2.INTER_AREA)
            matchable = (skipped < NOTHING_BUT_SKY).astype(np.uint8)
            initial.find_texture(level, threads, matchable, np.float32(options.min_texture**2))
            state = State(
                field=np.full((level.height, level.width, 4), (0, 0, 0, INVALID_COST), np.float32),
                chosen=np.zeros((level.height, level.width), dtype=np.uint16),
                active=matchable.copy(),
            )
            if coarse is None:
                # Inverse depth of the sparse point nearest to each pixel
                tree = cKDTree(problem.sparse_uv * np.divide(size, (view.width, view.height)))
                pixels = np.indices(skipped.shape)[::-1].reshape(2, -1).T + 0.5
                prior = (1.0 / problem.sparse_depth[tree.query(pixels)[1]]).astype(np.float32)
                initial.start_randomly(level, threads, state, prior.reshape(skipped.shape), seed)
            else:
                beyond = find_beyond(region, view, coarse.field, size)
                if index == 0:
                    above = cv2.resize(coarse.field, size, interpolation=cv2.INTER_NEAREST)
                    above[..., 1:3] *= np.divide(coarse.field.shape[1::-1], size, dtype=np.float32)
                    state.field[beyond] = above[beyond]
                    state.active[beyond] = 0
                # At a size between, what does not match once it is seen better is matched anew
                initial.start_from_coarse(level, threads, state, coarse, coarse_color)
                state.active[beyond] = 0
            if index == 0 and region is not None:
                center = view.R @ region.center + view.t
                ball = np.array([*center, CROWN_REACH * region.radius], dtype=np.float32)
                own, *others = (self.lines(i) for i in problem.photos)
                started = start_from_lines(level, state, matchable, own, others, ball, threads)
                twigs = cv2.dilate(
                    started.astype(np.uint8), np.ones((2 * LINE_REACH + 1,) * 2, np.uint8)
                )
                state.active[(twigs > 0) & (matchable > 0)] = 1
            # A sweep at half the size costs a quarter, so coarse levels get more of them. (One less
            # at each took 8 % off the time, and 1 to 2 % of what is found above 5 mm.)
            turns = [FIRST_TURN] + [FURTHER_TURN] * options.n_iterations
            if coarse is None:
                turns = [COARSEST_TURN] * (options.n_iterations + MORE_SWEEPS)
            elif index == 0:
                turns = [FULL_TURN] * options.n_iterations
            # How wide wood is shows in depths of the level above, or of a first sweep. The costs
            # at hand stay those of a flat patch: evaluating them took a fourth of the time, and
            # brought no depth nearer.
            first_bent = 1 if coarse is None else 0
            for i, turn in enumerate(turns):
                if i == first_bent:
                    level = _bent(level, threads, state)
                _sweep_twice(level, threads, state, turn, seed, n_swept)
                n_swept += 1
            coarse, coarse_color = state, level.color
        return state.field

    def geometric(self, problem: StereoProblem) -> np.ndarray:
        """Refine a reference with its sources' photometric depth maps, and filter it.

        The field, (height, width, 4) float32, has inverse depth 0 where fewer than
        `MIN_CONSISTENT` sources agree, and where a pixel of parallax moves a place by more than
        the radius of the region, if there is one.
        """
        options, threads, region = self.options, self.threads, self.workspace.region
        view = self.views[problem.view]
        own, *found = (
            self.workspace.read_depth(self.views[i], PHOTOMETRIC) for i in problem.photos
        )
        field = maps_to_field(own, self.workspace.read_normals(view, PHOTOMETRIC), view.K)
        level = self.level(problem, 0, found)
        active = (field[..., 0] > 0.0).astype(np.uint8)
        state = State(field, np.zeros(active.shape, dtype=np.uint16), active)
        level = _bent(level, threads, state)
        initial.evaluate_field(level, threads, state)
        # A twig that was given the hill's depth disagrees with the sources' maps, and stays active
        size = (level.width, level.height)
        active[find_beyond(region, view, state.field, size)] = 0
        splat = consistency.splat_sources(level, threads)
        consistency.adopt_from_sources(level, threads, state, splat)
        seed = view_seed(options.seed, view.name, 1)
        _sweep_twice(level, threads, state, CONSISTENT_TURN, seed, 0)
        enough = min(MIN_CONSISTENT, len(problem.sources))
        limits = np.float32(MOST_COST), np.float32(MOST_ERROR_PX)
        consistency.drop_inconsistent(level, threads, state.field, enough, *limits)
        if region is not None:
            state.field[state.field[..., 0] ** 2 < level.w_px / region.radius, 0] = 0.0
        return state.field


def _bent(level: Level, threads: int, state: State) -> Level:
    """Return the level with the bend of the wood that its pixels' depths show."""
    bend = np.zeros((level.height, level.width, 3), np.float32)
    # The median takes lonely outliers out
    find_bend(level, threads, state.active, cv2.medianBlur(state.field[..., 0].copy(), 3), bend)
    return level._replace(bend=bend)


def _sweep_twice(
    level: Level, threads: int, state: State, turn: Turn, seed: int, number: int
) -> None:
    """Sweep over one colour of the checkerboard, then over the other."""
    for parity in (0, 1):
        draw = seed + ((2 * number + parity + 1) << SWEEP_BITS)
        patchmatch.sweep(level, threads, state, parity, turn, draw)


def find_beyond(
    region: Region | None, view: View, field: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Return the pixels around which a field matches nothing but what lies beyond the region.

    They are not refined: hills and hedges are half of what the photos of an orchard show. The field
    is that of a level of ``size`` (width, height) or of a coarser one; (height, width) bool.
    """
    height, width = field.shape[:2]
    if region is None:
        return np.zeros(size[::-1], dtype=bool)
    K, R, t = view.kernel_camera(width, height)
    x = (np.arange(width, dtype=np.float32) - K[0, 2]) / K[0, 0]
    y = (np.arange(height, dtype=np.float32) - K[1, 2]) / K[1, 1]
    center = R @ region.center + t
    w = field[..., 0]
    # |ray / w - center| > radius, times w
    off = (x[None, :] - center[0] * w) ** 2 + (y[:, None] - center[1] * w) ** 2
    off += (1.0 - center[2] * w) ** 2
    beyond = (w > 0.0) & (field[..., 3] < HOPELESS_COST) & (off > (region.radius * w) ** 2)
    around = np.ones((2 * BEYOND_MARGIN + 1,) * 2, np.uint8)
    sure = cv2.erode(beyond.astype(np.uint8), around, borderValue=1)
    return cv2.resize(sure, size, interpolation=cv2.INTER_NEAREST) > 0


def field_to_maps(field: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn a field into depth (height, width) and normals (height, width, 3), float32.

    The field is (height, width, >= 3): inverse depth, 0 where unknown, and slopes. Normals are unit
    vectors in the camera frame, towards the camera; depth and they are 0 where it is unknown. The
    intrinsics ``K`` have pixel centres at (0.5, 0.5).
    """
    height, width = field.shape[:2]
    known = field[..., 0] > 0.0
    w, gx, gy = field[known, :3].T
    x, y = (np.broadcast_to(ray, known.shape)[known] for ray in _rays(width, height, K))
    m1 = gx * np.float32(K[0, 0])
    m2 = gy * np.float32(K[1, 1])
    outward = np.stack([m1, m2, w - x * m1 - y * m2], axis=-1)
    depth = np.zeros(known.shape, dtype=np.float32)
    depth[known] = 1.0 / w
    normals = np.zeros((*known.shape, 3), dtype=np.float32)
    normals[known] = -outward / np.linalg.norm(outward, axis=-1, keepdims=True)
    return depth, normals


def _rays(width: int, height: int, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where the rays of a row (width,) and of a column (height, 1) of pixels go."""
    x = (np.arange(width, dtype=np.float32) + np.float32(0.5 - K[0, 2])) / np.float32(K[0, 0])
    y = (np.arange(height, dtype=np.float32) + np.float32(0.5 - K[1, 2])) / np.float32(K[1, 1])
    return x, y[:, None]


def maps_to_field(depth: np.ndarray, normals: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Turn depth (height, width) and normals (height, width, 3) into a field with cost zero."""
    height, width = depth.shape
    x, y = _rays(width, height, K)
    along = normals[..., 0] * x + normals[..., 1] * y + normals[..., 2]
    known = (depth > 0.0) & (along < 0.0)
    field = np.zeros((height, width, 4), dtype=np.float32)
    w = field[..., 0]
    np.divide(1.0, depth, out=w, where=known)
    ratio = np.zeros_like(w)
    np.divide(w, along, out=ratio, where=known)
    field[..., 1] = normals[..., 0] * ratio / np.float32(K[0, 0])
    field[..., 2] = normals[..., 1] * ratio / np.float32(K[1, 1])
    return field
