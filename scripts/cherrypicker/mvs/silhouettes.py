"""Twigs from their silhouettes: points where several photos show a thin line before clear sky.

A window of pixels matches a twig of one pixel badly, but its line before the sky is sharp. So each
photo's lines (`cherrypicker.mvs.lines.sky_lines`) that no point of the cloud explains are followed
along their rays through the region of interest. A place is wood where lines of other photos meet it
too, all of them the image of one direction in space, and where so many lines do not meet by chance,
nor against the word of the photos that show clear sky there, each of which says as much as it knows
(`cherrypicker.evidence.witnesses`). What lies before wood, hills or ground says neither yes nor no.

Space carving (Kutulakos and Seitz, IJCV 2000) asks the same of all photos; here the photo's lines,
not voxels, are carried into space, so that a twig thinner than any voxel keeps its place.
"""

import logging
from typing import NamedTuple

import numpy as np

from cherrypicker.compiled import Num, in_parallel, inlined, kernel
from cherrypicker.mvs.kernels.projection import cross_ball
from cherrypicker.mvs.lines.lines import (
    CLEAR,
    TOLERANCE_PX,
    Lines,
    explain,
    gather_lines,
    line_shown,
    off_line,
    project_place,
)
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.placement.region import NEAREST, Region
from cherrypicker.pointcloud import PointCloud, joined
from cherrypicker.progress import Progress

logger = logging.getLogger(__name__)

# Step along a ray, in pixels of the photo at the place: the parallax in a like photo is no larger
STEP_PX = 0.5
# Lines are the image of one direction within 15 degrees (sine): a line of one pixel in noise
# (guess)
DIRECTION_SINE = 0.26
# Two planes through lines give a direction where they cross at 10 degrees or more (sine; guess)
CROSSING_SINE = 0.17
# Photos that look from directions nearer than 5 degrees see nearly the same (cosine; guess)
APART_COSINE = 0.9962
# Expected number of places on a ray that photos agree on by chance (guess)
CHANCE = 0.05
# Photos besides its own that a place needs however little chance there is (guess)
LEAST_WITNESSES = 3
# Sum of the words of photos with clear sky from which on a place is given up: no lines of as many
# photos as look from sides of their own outweigh it (guess)
MOST_AGAINST = -20.0
# Most uncertain depth, in pixels of the photo at the place, for an error of a pixel in each photo
# (guess)
MOST_DEPTH_PX = 3.0
# Line points that a thread takes at a time
LINES_AT_A_TIME = 256


class Sight(NamedTuple):
    """The rays of one photo's line points."""

    own: int  # the photo
    rays: np.ndarray  # (n, 3) float64: directions from its centre, of depth 1
    ball: np.ndarray  # (4,) float64: centre of the region from the photo's, and its radius
    nearest: float  # least depth that is asked
    pixel: float  # size of a pixel at depth 1


class Scratch(NamedTuple):
    """What a thread writes on: lines met, (n_views,), those kept and on trial, (2, n_views), all
    int64, and the axis of a twig, (3,) float64."""

    met: np.ndarray
    kept: np.ndarray
    axis: np.ndarray


@inlined
def _place(lines: Lines, sight: Sight, row: Num, depth: Num) -> tuple[Num, Num, Num]:
    """Return the place at a depth on a ray."""
    x = lines.centers[sight.own, 0] + depth * sight.rays[row, 0]
    y = lines.centers[sight.own, 1] + depth * sight.rays[row, 1]
    z = lines.centers[sight.own, 2] + depth * sight.rays[row, 2]
    return x, y, z


@inlined
def _is_apart(
    lines: Lines, i: Num, own: Num, kept: np.ndarray, n: Num, x: Num, y: Num, z: Num
) -> bool:
    """Whether photo ``i`` looks at a place from elsewhere than ``own`` and the photos kept."""
    ax, ay, az = lines.centers[i, 0] - x, lines.centers[i, 1] - y, lines.centers[i, 2] - z
    a = ax * ax + ay * ay + az * az
    for k in range(-1, n):
        j = own if k < 0 else lines.owner[kept[1, k]]
        bx, by, bz = lines.centers[j, 0] - x, lines.centers[j, 1] - y, lines.centers[j, 2] - z
        b = bx * bx + by * by + bz * bz
        if ax * bx + ay * by + az * bz > APART_COSINE * np.sqrt(a * b):
            return False
    return True


@inlined
def _consent(
    lines: Lines, line: np.ndarray, n: Num, x: Num, y: Num, z: Num, scratch: Scratch
) -> tuple[Num, Num]:
    """Keep as many of the lines met as are, with ``line``, the image of one direction.

    That direction goes to ``scratch.axis``. Returns their surprise and their number.
    """
    most = 0.0
    n_most = 0
    m, met, kept, axis = lines.plane, scratch.met, scratch.kept, scratch.axis
    for a in range(n):
        j = met[a]
        dx = m[line, 1] * m[j, 2] - m[line, 2] * m[j, 1]
        dy = m[line, 2] * m[j, 0] - m[line, 0] * m[j, 2]
        dz = m[line, 0] * m[j, 1] - m[line, 1] * m[j, 0]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        if length < CROSSING_SINE:
            continue
        surprise = np.log(DIRECTION_SINE)  # that of the first is no surprise: it gives the axis
        n_kept = 0
        for b in range(n):
            k = met[b]
            if abs(m[k, 0] * dx + m[k, 1] * dy + m[k, 2] * dz) > DIRECTION_SINE * length:
                continue
            if _is_apart(lines, lines.owner[k], lines.owner[line], kept, n_kept, x, y, z):
                kept[1, n_kept] = k
                n_kept += 1
                surprise += lines.surprise[k] - np.log(DIRECTION_SINE)
        if n_kept > 0 and surprise > most:
            most, n_most = surprise, n_kept
            for b in range(n_kept):
                kept[0, b] = kept[1, b]
            axis[0], axis[1], axis[2] = dx / length, dy / length, dz / length
    return most, n_most


@inlined
def _ask(lines: Lines, sight: Sight, row: Num, depth: Num, scratch: Scratch) -> tuple[Num, Num]:
    """Ask the other photos about a place; return how surprising their consent is, and their number.

    The word of those that show clear sky counts against it, and ends the search where it is more
    than lines can outweigh.
    """
    x, y, z = _place(lines, sight, row, depth)
    n, against = 0, 0.0
    for k in range(lines.order.shape[0]):
        i = lines.order[k]
        if i == sight.own:
            continue
        line = line_shown(lines, i, x, y, z)
        if line == CLEAR:
            against += lines.clear_word[i]
            if against < MOST_AGAINST:
                return against, 0
        if line >= 0:
            scratch.met[n] = line
            n += 1
    if n < LEAST_WITNESSES:
        return against, 0
    surprise, n = _consent(lines, lines.first[sight.own] + row, n, x, y, z, scratch)
    if n < LEAST_WITNESSES:
        return against, 0
    return surprise + against, n


@inlined
def _refined(
    lines: Lines, sight: Sight, row: Num, depth: Num, n: Num, kept: np.ndarray
) -> tuple[Num, Num]:
    """Return the depth that fits the ``n`` lines kept best, and its uncertainty, px."""
    top = 0.0
    bottom = 0.0
    step = depth * sight.pixel
    x, y, z = _place(lines, sight, row, depth)
    farther_x, farther_y, farther_z = _place(lines, sight, row, depth + step)
    for b in range(n):
        line = kept[0, b]
        i = lines.owner[line]
        u, v, _ = project_place(lines, i, x, y, z)
        off = off_line(lines, line, u, v)
        u, v, _ = project_place(lines, i, farther_x, farther_y, farther_z)
        moved = off_line(lines, line, u, v) - off
        top += off * moved
        bottom += moved * moved
    bottom = max(bottom, 1e-9)
    return depth - step * top / bottom, 1.0 / np.sqrt(bottom)


@kernel
def _follow(
    lines: Lines,
    sight: Sight,
    first: Num,
    last: Num,
    scratch: Scratch,
    depths: np.ndarray,
    axes: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Enter the depth of most consent on rays ``first`` to ``last``, fitted to the lines there.

    ``counts`` takes the number of photos, 0 where the place may be chance or does not hold once it
    is fitted, ``axes`` (n, 3) the direction of the twig.
    """
    for row in range(first, last):
        counts[row] = 0
        x, y, z = sight.rays[row, 0], sight.rays[row, 1], sight.rays[row, 2]
        middle, square = cross_ball(x, y, z, sight.ball)
        half = np.sqrt(max(square, 0.0))
        low, high = max(middle - half, sight.nearest), max(middle + half, sight.nearest)
        if high <= low or lines.explained[lines.first[sight.own] + row] > 0.0:
            continue
        # At this surprise a ray has less than `CHANCE` places by chance: those two tolerances apart
        # show other pixels, so that many may each be one
        least = np.log(np.log(high / low) / (2.0 * TOLERANCE_PX * sight.pixel * CHANCE))
        most = least
        found = 0.0
        depth = low
        while depth < high:
            surprise, _ = _ask(lines, sight, row, depth, scratch)
            if surprise > most:
                most = surprise
                found = depth
            depth *= 1.0 + STEP_PX * sight.pixel
        if found <= 0.0:
            continue
        _, n = _ask(lines, sight, row, found, scratch)
        found, unsure = _refined(lines, sight, row, found, n, scratch.kept)
        surprise, n = _ask(lines, sight, row, found, scratch)
        if surprise >= least and unsure <= MOST_DEPTH_PX:
            depths[row] = found
            counts[row] = 1 + n
            for c in range(3):
                axes[row, c] = scratch.axis[c]


def add_silhouettes(
    photos: ScanPhotos,
    cloud: PointCloud,
    region: Region,
    clear_word: np.ndarray,
    *,
    threads: int = 1,
) -> PointCloud:
    """Add the twigs that the photos show before the sky to a fused cloud.

    The cloud is in the photos' frame, with normals and colours; twigs are looked for in the region.
    ``clear_word``, (n_photos,) float64, is what a photo says that shows clear sky at a place, see
    `Lines`. In memory: 4 bytes for each pixel of all photos, and the cloud twice.

    The points added lie on the twigs' axes: a field ``from_silhouette`` (uint8) is 1 for them.
    Their ``n_views`` are the photos whose lines meet, no two of which look from the same direction;
    their normals point at the photo that they were found in, across the twig.
    """
    lines = gather_lines(photos, clear_word)
    explain(lines, cloud.points, threads)
    n_open = int((lines.explained == 0.0).sum())
    parts = [cloud.with_fields(from_silhouette=np.zeros(len(cloud), np.uint8))]
    with Progress(len(photos.views), "photos' twigs followed") as bar:
        for i in range(len(photos.views)):
            parts.append(_twigs_of(photos, lines, i, region, threads))
            explain(lines, parts[-1].points, threads)  # so that each place is found once
            bar.step()
    logger.info(
        f"of {len(lines.owner):,} pixels on thin lines before the sky the cloud lacks {n_open:,}: "
        f"{sum(map(len, parts[1:])):,} points added"
    )
    return joined(parts)


def _twigs_of(photos: ScanPhotos, lines: Lines, i: int, region: Region, threads: int) -> PointCloud:
    """Return the places that one photo's lines show and nothing explains yet."""
    view = photos.views[i]
    uv = lines.uv[lines.first[i] : lines.first[i + 1]]
    rays = view.rays(uv)
    offset = region.center - view.center
    nearest = NEAREST * float(np.linalg.norm(offset))
    sight = Sight(i, rays, np.array([*offset, region.radius]), nearest, 1.0 / view.K[0, 0])
    n, n_views = len(rays), len(photos.views)
    depths, axes, counts = np.zeros(n), np.zeros((n, 3)), np.zeros(n, dtype=np.int64)

    def work(first: int) -> None:
        met, kept = np.empty(n_views, np.int64), np.empty((2, n_views), np.int64)
        last = min(first + LINES_AT_A_TIME, n)
        _follow(lines, sight, first, last, Scratch(met, kept, np.empty(3)), depths, axes, counts)

    in_parallel(work, range(0, n, LINES_AT_A_TIME), threads)
    kept = np.flatnonzero(counts)
    points = view.center + depths[kept, None] * rays[kept]
    at = np.floor(uv[kept]).astype(int)
    to_camera, axes = view.center - points, axes[kept]
    normals = to_camera - np.einsum("ni,ni->n", to_camera, axes)[:, None] * axes
    return PointCloud(
        points,
        colors=photos.photo(i)[at[:, 1], at[:, 0]] / 255.0,
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        fields={
            "n_views": np.minimum(counts[kept], 255).astype(np.uint8),
            "from_silhouette": np.ones(len(kept), np.uint8),
        },
    )
