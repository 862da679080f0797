"""What all photos say of places: the logarithm of how much likelier they are with wood there.

How often a photo shows wood that is there, and how often something where nothing is, depends on its
blur, noise and sky, on its camera's error and on how wide the wood is in it. So both are counted in
each photo: at places that the scan is sure of, and at places beside them where nothing is known to
be. A photo that is off by some pixels shows sky at wood as often as anywhere: its word is worth
nothing, and nobody has to know that it is off.

A photo shows clear sky, something thin, something solid, each before or behind or without what its
depth map holds there. That a depth map holds the place itself is no witness of it: the skeleton
comes from the maps. That a map looks through it, is one against it where the cloud holds points.
"""

from enum import IntEnum
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.mvs.lines.sky_lines import DENSITY_PX
from cherrypicker.mvs.raster import CLEAR_BELOW, HIDDEN, N_KINDS
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.progress import Progress

# A photo does not frame the place, or its user hides it
UNASKED = np.iinfo(np.uint8).max


class Depth(IntEnum):
    """What a depth map says of a place: nothing, something lies before it, all lies behind it."""

    OPEN = 0
    BEFORE = 1
    BEHIND = 2


N_SHOWN = len(Depth) * N_KINDS
# A depth that differs by more than so much of it, and the wood's own width, is another thing's
SAME_DEPTH = 0.01
# Widths of wood in a photo at which a table begins, px, and shares of the surroundings that are no
# clear sky
WIDTHS_PX = (0.0, 1.0, 2.0, 4.0, 8.0)
THIN_PX = 4.0  # what is found as a line, and whose width its edges do not tell
CROWDS = (0.0, 0.03, 0.1, 0.3, 0.6)
N_CELLS = len(WIDTHS_PX) * len(CROWDS)
# Counts of all photos together that stand in for a photo's own where these are few
SHARED_COUNTS = 20.0
# What nobody can know, a probability: the most that one photo, and all of them, can say of a place
DOUBT = 0.002
# What lies within so many pixels of wood is the same wood
SAME_PX = 3.0


class Seen(NamedTuple):
    """What photos show at places, each ndarray of shape (n_photos, n_places), uint8."""

    # the most that a photo shows within the slack, see `cherrypicker.mvs.raster`, and what its
    # depth map says: `N_KINDS` times a `Depth` more; or `UNASKED`
    shown: np.ndarray
    cell: np.ndarray  # class of width and surroundings

    def at(self, places: np.ndarray) -> "Seen":
        """What photos show at some of the places."""
        return Seen(self.shown[:, places], self.cell[:, places])


def look(
    photos: ScanPhotos,
    points: np.ndarray,
    radius: np.ndarray,
    reach: float = 0.0,
    *,
    by_depth: bool = False,
) -> Seen:
    """Look at places (n_places, 3), with wood of a radius (n_places,), in all photos.

    ``reach`` tells how far about a place wood is asked for, beside the photos' own slack, in the
    points' unit; ``by_depth`` whether the depth maps are asked too: not about what the maps may
    have lost.
    """
    poses = photos.poses
    shown = np.full((len(poses), len(points)), UNASKED, np.uint8)
    cell = np.zeros_like(shown)
    with Progress(len(poses), "photos asked what is there") as bar:
        for i in range(len(poses)):
            uv, depth = poses[i].project(points)
            size = (poses.width[i], poses.height[i])
            with np.errstate(invalid="ignore"):
                rows = np.flatnonzero((depth > 0) & ((uv >= 0) & (uv < size)).all(axis=1))
            if len(rows):
                focal, own = poses.K[i, 0, 0], depth[rows]
                slack = photos.slack_px[i] + reach * focal / float(np.median(own))
                x, y = uv[rows].astype(int).T
                kind, crowd = _at(photos.raster(i), x, y, slack)
                depths = photos.depth(i) if by_depth else None
                far = _by_depth(depths, x, y, own, reach + 2 * radius[rows])
                asked = kind != UNASKED
                width = _class_of(2 * radius[rows] * focal / own, WIDTHS_PX)
                shown[i, rows[asked]] = (N_KINDS * far + kind)[asked]
                cell[i, rows] = width * len(CROWDS) + crowd
            bar.step()
    return Seen(shown, cell)


def _at(raster: np.ndarray, x: np.ndarray, y: np.ndarray, slack: float) -> tuple:
    """The most that a raster shows about pixels, and the class of their surroundings, (n,)."""
    is_hidden = (raster == HIDDEN).astype(np.uint8)
    pixels = np.where(is_hidden > 0, 0, raster).astype(np.uint8)
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * int(np.ceil(slack)) + 1,) * 2)
    window = np.ones_like(window) if slack <= 1 else window
    kind = np.asarray(cv2.dilate(pixels, window))[y, x]
    crowd = cv2.blur((pixels >= CLEAR_BELOW).astype(np.float32), (DENSITY_PX, DENSITY_PX))[y, x]
    if is_hidden.any():
        kind[np.asarray(cv2.dilate(is_hidden, window))[y, x] > 0] = UNASKED
    return kind, _class_of(crowd, CROWDS)


def _class_of(value: np.ndarray, begins: tuple[float, ...]) -> np.ndarray:
    """Classes of values, (n,), by where each begins; what is less is of the first."""
    return np.searchsorted(begins[1:], value, side="right")


def _by_depth(
    depths: np.ndarray | None, x: np.ndarray, y: np.ndarray, own: np.ndarray, room: np.ndarray
) -> np.ndarray:
    """The `Depth` of pixels whose places lie at depths ``own``, (n,) uint8."""
    if depths is None:
        return np.zeros(len(x), np.uint8)
    room = room + SAME_DEPTH * own
    height, width = depths.shape
    is_known, is_nearer, is_farther = np.zeros(len(x), bool), *np.ones((2, len(x)), bool)
    for dx, dy in np.ndindex(3, 3):
        found = depths[np.clip(y + dy - 1, 0, height - 1), np.clip(x + dx - 1, 0, width - 1)]
        known = found > 0
        is_known |= known
        is_nearer &= ~known | (found < own - room)
        is_farther &= ~known | (found > own + room)
    behind = np.where(is_known & is_farther, Depth.BEHIND, Depth.OPEN)
    return np.where(is_known & is_nearer, Depth.BEFORE, behind)


def count(seen: Seen, weight: np.ndarray) -> np.ndarray:
    """How often each photo shows what, by cell, (n_photos, N_CELLS, N_SHOWN) float64.

    Each place counts by its weight (n_places,), float64.
    """
    found = np.zeros((len(seen.shown), N_CELLS * N_SHOWN))
    for i, (shown, cell) in enumerate(zip(seen.shown, seen.cell, strict=True)):
        asked = shown != UNASKED
        at = cell[asked].astype(np.int64) * N_SHOWN + shown[asked]
        found[i] = np.bincount(at, weight[asked], minlength=N_CELLS * N_SHOWN)
    return found.reshape(len(found), N_CELLS, N_SHOWN)


class Shares(NamedTuple):
    """Probabilities of what is shown, each (n_photos, N_CELLS, N_SHOWN) float64."""

    # there, away: at places with wood and without
    there: np.ndarray
    away: np.ndarray


def shares(there: np.ndarray, away: np.ndarray) -> Shares:
    """Probabilities from counts, pooled where a photo has seen little.

    A cell in which no photo has seen wood is filled from others of its width, from those of all
    widths, and where there are none, with what is shown without wood: nobody has a word.
    """
    without = away.sum(axis=0)
    flat = (without.sum(axis=0) + 1.0) / (without.sum() + N_SHOWN)
    without = _mixed(without, flat, SHARED_COUNTS)
    cells = there.sum(axis=0)
    by_width = cells.reshape(len(WIDTHS_PX), -1, N_SHOWN).sum(axis=1)
    around = np.repeat(by_width, len(CROWDS), axis=0)
    anywhere = _mixed(cells.sum(axis=0), without, 1.0)
    with_wood = _mixed(cells, _mixed(around, anywhere, 1.0), 1.0)
    return Shares(*(_mixed(*pair, SHARED_COUNTS) for pair in ((there, with_wood), (away, without))))


def _mixed(counts: np.ndarray, pooled: np.ndarray, weight: float) -> np.ndarray:
    mixed = counts + weight * pooled
    return mixed / mixed.sum(axis=-1, keepdims=True)


def without_depth(learnt: Shares) -> Shares:
    """The same probabilities of what rasters show, of `N_KINDS`, whatever the depth maps say."""
    return Shares(*(each.reshape(-1, N_CELLS, len(Depth), N_KINDS).sum(axis=2) for each in learnt))


def by_raster(seen: Seen) -> Seen:
    """What was seen whatever the depth maps say, see `without_depth`."""
    kind = np.where(seen.shown == UNASKED, UNASKED, seen.shown % N_KINDS)
    return Seen(kind.astype(np.uint8), seen.cell)


def words(seen: Seen, learnt: Shares) -> np.ndarray:
    """Each photo's word on each place, (n_photos, n_places) float32: 0 where it has none."""
    ratio = bounded(np.log(learnt.there / learnt.away)).astype(np.float32)
    told = np.zeros(seen.shown.shape, np.float32)
    for i, (shown, cell) in enumerate(zip(seen.shown, seen.cell, strict=True)):
        asked = shown != UNASKED
        told[i, asked] = ratio[i, cell[asked], shown[asked]]
    return told


def beside(
    points: np.ndarray,
    radius: np.ndarray,
    pixel: float,
    rng: np.random.Generator,
    others: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Places beside wood that are no wood, and the rows of those that they lie beside.

    They lie in any direction within its surroundings, as often near as far: what is wrong in a
    skeleton lies beside wood more often than in the open. The wood lies at points (n, 3) with a
    radius (n,); ``pixel`` is the size of one there. Points of wood that they keep off as well are
    ``others`` (n_others, 3).
    """
    way = rng.normal(size=points.shape)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    far = radius + pixel * np.exp(rng.uniform(np.log(SAME_PX), np.log(DENSITY_PX / 2), len(points)))
    moved = points + far[:, None] * way
    distance, nearest = cKDTree(points).query(moved)
    is_free = distance > radius[nearest] + SAME_PX * pixel
    if others is not None:
        is_free &= cKDTree(others).query(moved)[0] > SAME_PX * pixel
    free = np.flatnonzero(is_free)
    return moved[free], free


def bounded(ratio: np.ndarray) -> np.ndarray:
    """Logarithms of likelihood ratios of who is wrong, either way, with a probability `DOUBT`."""
    odds = np.exp(np.clip(ratio, -50.0, 50.0))
    return np.log((odds * (1.0 - DOUBT) + DOUBT) / (odds * DOUBT + 1.0 - DOUBT))


def information(seen: Seen, learnt: Shares) -> np.ndarray:
    """What the photos are expected to say of wood at places, (n_places,) float64.

    The sum over photos of the divergence (Kullback and Leibler 1951) of what is shown of wood from
    what is shown without.
    """
    expected = (learnt.there * np.log(learnt.there / learnt.away)).sum(axis=2)
    asked = seen.shown != UNASKED
    rows = np.arange(len(seen.shown))[:, None]
    return np.where(asked, expected[rows, seen.cell], 0.0).sum(axis=0)


def clear_words(there: np.ndarray, away: np.ndarray) -> np.ndarray:
    """What each photo says of thin wood where it shows clear sky, (n_photos,) float64, 0 at most.

    By what `count` tells of places with wood and without, (n_photos, N_CELLS, N_SHOWN) each.
    """
    thin = slice(0, WIDTHS_PX.index(THIN_PX) * len(CROWDS))
    clear = []
    for counts in (there, away):
        by_kind = counts[:, thin].reshape(len(counts), -1, N_KINDS).sum(axis=1)
        by_kind = np.stack([by_kind[:, :CLEAR_BELOW].sum(axis=1), by_kind.sum(axis=1)])
        pooled = (by_kind.sum(axis=1) + [0.5, 1.0]) * SHARED_COUNTS / (by_kind[1].sum() + 1.0)
        clear.append(np.divide(*(by_kind + pooled[:, None])))
    return np.minimum(bounded(np.log(clear[0] / clear[1])), 0.0)
