"""Buds: where the silhouette of thin wood before clear sky bulges on one side.

Each photo tells how far wood reaches to both sides of its axis. What reaches farther than the wood
around it is a bulge, if the photos that look across it agree: a twig behind, a cloud's edge or
lichen bulges in one photo, a bud in all. What noise makes stands in as often as out: dents tell
from which height on bulges are buds.
"""

import logging
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks
from scipy.spatial import cKDTree

from cherrypicker.files import rounded
from cherrypicker.geometry.directions import tangent_basis
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.photo_check.places import Places, places_along
from cherrypicker.photo_check.widths import LEAST_PHOTOS, SAMPLE_PX, light_of, lines_across
from cherrypicker.poses import View
from cherrypicker.progress import Progress
from cherrypicker.skeleton import Axis, axis_of_node
from cherrypicker.skeleton.model import Skeleton

logger = logging.getLogger(__name__)

# Places along an axis, m apart at most; an eighth of a bud, where edges are longer than that
STEP_M = 0.001
# Length of a bud, m: cherry's and apple's are of 5 to 10 mm. Wood of that radius and less is asked,
# lines run so far beside it, and so far apart two buds lie at least. Of 6, 8 and 10 mm none found
# more than 2 % more of the buds of three rendered scenes (2026-11-30), nor did twice the step
BUD_M = 0.008
# Directions around an axis that are asked for a bulge: 8 tell as much as 12 (the same scenes)
N_AROUND = 12
# How much a photo looks across a bulge that it is asked for: the cosine of the angle to its
# direction. At 0 and 0.7 fewer are found, at 0.3 a thirtieth more (the same scenes)
ACROSS = 0.5
# Share of the bulges that noise may have made (3 % of the same scenes' were), by dents for decoys:
# Barber and Candes, "Controlling the false discovery rate via knockoffs", 2015
MOST_FALSE = 0.2
# What stands out less is bark, m, or a net behind it: of 0.3, 0.4, 0.5 and 0.6 mm 17, 10, 4 and 1
# of what is found before a net are no buds, and 45, 40, 34 and 29 of 53 are found (2026-11-30)
LEAST_M = 0.0005
#: Of ``buds.csv``.
BUD_COLUMNS = ("branch_id", "at_m", "x", "y", "z", "stands_out_m", "n_photos")


class Buds(NamedTuple):
    """What photos tell of the buds of a tree."""

    found: list[dict]  # rows of `BUD_COLUMNS`
    n_on: np.ndarray  # (n_nodes,) float64: buds on the edge below each node
    told_m: np.ndarray  # (n_nodes,) float64: length of it on which the photos would show one
    noise_m: float  # what bulges of buds are above; inf where too few are above any


def find_buds(skeleton: Skeleton, axis_list: list[Axis], photos: ScanPhotos) -> Buds:
    """Find the buds on the thin wood of a skeleton in metres, in whose frame the photos are.

    Its edges are longer than `STEP_M`. Where too few bulges stand out to be told from noise,
    nothing is told.
    """
    places = places_along(skeleton, STEP_M)
    axis = axis_of_node(skeleton, axis_list)[places.node]
    is_asked = (places.radius <= BUD_M) & ~_beside_other_wood(places, axis)
    at = np.zeros(len(axis))
    for one in range(len(axis_list)):
        rows = np.flatnonzero(axis == one)
        at[rows] = np.cumsum(places.length[rows])
        is_asked[rows[at[rows] > at[rows[-1:]] - BUD_M]] = False  # that bud goes on with the axis
    along = np.lexsort((at, axis))
    asked = along[is_asked[along]]
    side, angle = ask_reach(photos, places.select(asked))
    height, dent = np.full((2, len(axis)), np.nan)
    n_photos = np.zeros(len(axis), dtype=int)
    n_photos[asked] = np.isfinite(side).any(axis=1).sum(axis=0)
    ends = np.flatnonzero((np.diff(at[asked]) > 1.5 * STEP_M) | (np.diff(axis[asked]) != 0)) + 1
    for run in filter(len, np.split(np.arange(len(asked)), ends)):
        height[asked[run]], dent[asked[run]] = bulges(side[:, :, run], angle[:, run])
    bumps, stands_out = peaks(height, axis)
    noise_m = noise_of(stands_out, peaks(dent, axis)[1])
    is_bud = stands_out > max(noise_m, LEAST_M)
    buds, stands_out = bumps[is_bud], stands_out[is_bud]
    is_told = np.isfinite(height) & np.isfinite(noise_m)
    found = [
        {"branch_id": int(axis[row]), "at_m": rounded(at[row])}
        | dict(zip("xyz", places.points[row].round(5).tolist(), strict=True))
        | {"stands_out_m": rounded(out), "n_photos": int(n_photos[row])}
        for row, out in zip(buds, stands_out, strict=True)
    ]
    n_on = np.bincount(places.node[buds], minlength=len(skeleton)).astype(float)
    told_m = np.bincount(places.node[is_told], places.length[is_told], len(skeleton))
    noise = f"{1e3 * noise_m:.2f} mm of noise" if np.isfinite(noise_m) else "noise hides all"
    logger.info(f"{len(found)} buds on {told_m.sum():.2f} m before clear sky: {noise}")
    return Buds(found, n_on, told_m, noise_m)


def _beside_other_wood(places: Places, axis: np.ndarray) -> np.ndarray:
    """Whether thin places are within a bud's length of other axes' wood, (n_places,) bool."""
    near = np.zeros(len(axis), dtype=bool)
    thin, thick = (np.flatnonzero(each) for each in (places.radius <= BUD_M, places.radius > BUD_M))
    tree = cKDTree(places.points[thin])
    found = tree.query_ball_point(places.points[thick], places.radius[thick] + 2 * BUD_M)
    of_thick = thin[np.fromiter(chain.from_iterable(found), dtype=int)]
    for pairs in (
        thin[tree.query_pairs(3 * BUD_M, output_type="ndarray")],
        np.column_stack([np.repeat(thick, [len(each) for each in found]), of_thick]),
    ):
        others = pairs[axis[pairs[:, 0]] != axis[pairs[:, 1]]]
        apart = np.linalg.norm(np.diff(places.points[others], axis=1)[:, 0], axis=1)
        near[others[apart <= places.radius[others].sum(axis=1) + BUD_M]] = True
    return near


def ask_reach(photos: ScanPhotos, places: Places) -> tuple[np.ndarray, np.ndarray]:
    """Ask all photos how far the wood of places reaches from its axis to both sides.

    That is (n_photos, 2, n_places) float32, m, and the angle of the second side around the axis,
    (n_photos, n_places) float32, radians. NaN where a photo does not tell.
    """
    n_photos, n = len(photos.views), len(places.points)
    side = np.full((n_photos, 2, n), np.nan, dtype=np.float32)
    angle = np.full((n_photos, n), np.nan, dtype=np.float32)
    with Progress(n_photos, "photos asked for buds") as bar:
        for i, framed in enumerate(photos.poses.frames(places.points)):
            if framed.any():
                side[i][:, framed], angle[i, framed] = _ask_photo(
                    *photos.at_full_size(i), places.select(framed)
                )
            bar.step()
    return side, angle


def _ask_photo(
    photo: np.ndarray, raster: np.ndarray, view: View, places: Places
) -> tuple[np.ndarray, np.ndarray]:
    """Reach to both sides (2, n), m, and angle (n,) of places in a photo."""
    _, depth = view.project(places.points)
    side, angle = np.full((2, len(depth)), np.nan), np.full(len(depth), np.nan)
    light = light_of(photo)
    around = tangent_basis(places.along)
    # Lines are as long as the longest that are sampled with them, those of the nearest place
    for block in np.array_split(np.argsort(depth), -(-len(depth) // 5000)):
        beside = BUD_M * view.K[0, 0] / depth[block]
        shown = lines_across(light, raster, view, places.select(block), beside)
        rows = block[shown.rows]
        side[:, rows] = shown.pixel * reach_of_wood(np.abs(shown.lost).max(axis=0))
        direction = shown.direction @ view.R[:2]
        first, second = np.einsum("nij,nj->in", around[rows], direction)
        angle[rows] = np.arctan2(second, first)
    return side, angle


def reach_of_wood(lost: np.ndarray) -> np.ndarray:
    """How far wood reaches to both sides of the middle of lines (n, m), (2, n) px.

    That is as far as they lose light. NaN where more than the wood in the middle takes some.
    """
    middle = lost.shape[1] // 2
    wood = max(np.median(lost[:, middle]), 1e-6) if len(lost) else 1.0
    cover = np.clip(2 * lost / wood - 0.5, 0, 1)  # an edge is where half of it is lost
    sides = np.stack([cover[:, middle::-1], cover[:, middle:]])
    beyond = sides * np.maximum.accumulate(sides == 0, axis=2)
    reach = SAMPLE_PX * (sides.sum(axis=2) - cover[:, middle] / 2)
    return np.where(beyond.max(axis=2, initial=0) > 0.5, np.nan, reach)


def bulges(side: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far places along a stretch stand out and in, m, (n,) float64 both, by `ask_reach`.

    That is the most over all directions around the axis of what the median photo says; NaN where
    too few look across.
    """
    highest, deepest = np.full((2, angle.shape[1]), np.nan)
    used = np.isfinite(angle).any(axis=1)
    side = np.concatenate([side[used, 0], side[used, 1]])
    angle = np.concatenate([angle[used] + np.pi, angle[used]])
    half = round(1.5 * BUD_M / STEP_M)  # of so much wood most has no bud
    around = np.pad(side, [(0, 0), (half, half)], constant_values=np.nan)
    window = sliding_window_view(around, 2 * half + 1, axis=1)
    beyond = _smoothed(side - _median(window, axis=2))
    for turn in 2 * np.pi * np.arange(N_AROUND if used.any() else 0) / N_AROUND:
        told = np.where(np.cos(angle - turn) > ACROSS, beyond, np.nan)
        height = _median(told, axis=0)
        height[np.isfinite(told).sum(axis=0) < LEAST_PHOTOS] = np.nan
        highest, deepest = np.fmax(highest, height), np.fmax(deepest, -height)
    return highest, deepest


def peaks(height: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The bulges of each axis, a bud's length apart: rows of their tops and prominences, m."""
    rows, stands_out = [np.empty(0, dtype=int)], [np.empty(0)]
    for one in np.unique(axis):
        own = np.flatnonzero(axis == one)
        profile = np.concatenate([[0.0], np.nan_to_num(np.fmax(height[own], 0.0)), [0.0]])
        highest, found = find_peaks(profile, distance=BUD_M / STEP_M, prominence=0.0)
        rows.append(own[highest - 1])
        stands_out.append(found["prominences"])
    return np.concatenate(rows), np.concatenate(stands_out)


def noise_of(height: np.ndarray, dent: np.ndarray) -> float:
    """The least height (m) above which at most `MOST_FALSE` of the bulges are noise; inf for none.

    By heights of bulges and depths of dents, (n,) and (m,), of which noise makes as many.
    """
    for noise in np.sort(np.append(dent, 0.0)):
        if 1 + np.count_nonzero(dent > noise) <= MOST_FALSE * np.count_nonzero(height > noise):
            return float(noise)
    return np.inf


def _median(values: np.ndarray, axis: int) -> np.ndarray:
    """As `np.nanmedian` without its warnings, at a seventh of its time."""
    values = np.moveaxis(np.sort(values, axis=axis), axis, 0)
    last = np.isfinite(values).sum(axis=0)[None] - 1
    low, high = (np.take_along_axis(values, each, axis=0)[0] for each in (last // 2, -(-last // 2)))
    return (low + high) / 2


def _smoothed(values: np.ndarray) -> np.ndarray:
    """Values (n, n_places) smoothed along an axis by a quarter of a bud, NaN where most are."""
    known = np.isfinite(values)
    share = gaussian_filter1d(known.astype(float), BUD_M / 4 / STEP_M, axis=1)
    total = gaussian_filter1d(np.where(known, values, 0.0), BUD_M / 4 / STEP_M, axis=1)
    return np.where(share > 0.5, total / np.maximum(share, 1e-9), np.nan)
