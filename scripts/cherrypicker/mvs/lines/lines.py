"""The thin lines of all photos before the sky, in one place, and which of them a cloud explains."""

from typing import NamedTuple

import numpy as np

from cherrypicker.compiled import Num, in_parallel, inlined, kernel
from cherrypicker.mvs.kernels.fusion import SAME_SURFACE
from cherrypicker.mvs.lines.sky_lines import SkyLines, find_sky_lines
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.progress import Progress

# A place is on a photo's line within so many pixels across: the error of poses and of lines
# (guess)
TOLERANCE_PX = 0.75
# How far from a line's point a point of the cloud may lie that explains it, px: the cloud has about
# one a pixel (guess)
EXPLAINS_PX = 1.5
# What a pixel's place in the maps holds where it holds no line
NOTHING, CLEAR = -1, -2


class Lines(NamedTuple):
    """The lines of all photos, as the kernels take them."""

    # (n_pixels,) int32: all photos' pixels: the line point in or beside it, `NOTHING` or `CLEAR`
    maps: np.ndarray
    # starts, sizes: (n_views,) and (n_views, 2) int64: where a photo begins in ``maps``, its width
    # and height
    starts: np.ndarray
    sizes: np.ndarray
    order: np.ndarray  # (n_views,) int64: the photos, those whose sky says most first
    # (n_views,) float64: what it says of a place that a photo shows clear sky there, the logarithm
    # of a likelihood ratio, below 0
    clear_word: np.ndarray
    projections: np.ndarray  # (n_views, 12) float64: K [R | t] by rows
    focal: np.ndarray  # (n_views,) float64, px
    centers: np.ndarray  # (n_views, 3) float64
    first: np.ndarray  # (n_views + 1,) int64: where a photo's line points begin
    owner: np.ndarray  # (n,) int64: the photo of each line point
    # uv, across: (n, 2) float64: line points and unit vectors across the lines, px
    uv: np.ndarray
    across: np.ndarray
    plane: np.ndarray  # (n, 3) float64: unit normals of the planes through camera and line, world
    # (n,) float64: minus logarithm of the chance that a place in the sky around lies on a line
    surprise: np.ndarray
    # (n,) float64: depth of the point of the cloud that a line point shows, 0 where there is none
    explained: np.ndarray


@inlined
def project_place(lines: Lines, i: Num, x: Num, y: Num, z: Num) -> tuple[Num, Num, Num]:
    """Return pixel (u, v) and depth of a place in photo ``i``."""
    P = lines.projections
    depth = P[i, 8] * x + P[i, 9] * y + P[i, 10] * z + P[i, 11]
    u = (P[i, 0] * x + P[i, 1] * y + P[i, 2] * z + P[i, 3]) / depth
    v = (P[i, 4] * x + P[i, 5] * y + P[i, 6] * z + P[i, 7]) / depth
    return u, v, depth


@inlined
def off_line(lines: Lines, line: np.ndarray, u: Num, v: Num) -> Num:
    """Distance of a pixel to a line, px, with a sign."""
    du, dv = u - lines.uv[line, 0], v - lines.uv[line, 1]
    return du * lines.across[line, 0] + dv * lines.across[line, 1]


@inlined
def line_shown(lines: Lines, i: Num, x: Num, y: Num, z: Num) -> Num:
    """Return the line point that photo ``i`` shows at a place, NOTHING or CLEAR."""
    u, v, depth = project_place(lines, i, x, y, z)
    if depth <= 0.0 or u < 0.0 or v < 0.0:
        return NOTHING
    if u >= lines.sizes[i, 0] or v >= lines.sizes[i, 1]:
        return NOTHING
    line = lines.maps[lines.starts[i] + np.int64(v) * lines.sizes[i, 0] + np.int64(u)]
    if line < 0:
        return line
    if abs(off_line(lines, line, u, v)) > TOLERANCE_PX:
        return NOTHING
    known = lines.explained[line]
    # A line that shows a point says nothing of places at other depths than the point's
    if known > 0.0 and abs(known - depth) > SAME_SURFACE * depth:
        return NOTHING
    return line


@kernel
def _explain(lines: Lines, points: np.ndarray, radius: np.ndarray, i: Num) -> None:
    """Enter the depth of the nearest point or ball at the lines of photo ``i`` that they meet."""
    width, height = lines.sizes[i, 0], lines.sizes[i, 1]
    for row in range(points.shape[0]):
        u, v, depth = project_place(lines, i, points[row, 0], points[row, 1], points[row, 2])
        if depth <= 1e-9 or not (u >= 0.0 and v >= 0.0 and u < width and v < height):
            continue
        reach, around = EXPLAINS_PX, 1.0
        if len(radius) > 0:
            reach += radius[row] * lines.focal[i] / depth
            around = reach
        elif lines.maps[lines.starts[i] + np.int64(v) * width + np.int64(u)] < 0:
            continue
        for y in range(max(int(v - around), 0), min(int(v + around) + 1, height)):
            for x in range(max(int(u - around), 0), min(int(u + around) + 1, width)):
                line = lines.maps[lines.starts[i] + y * width + x]
                if line < 0:
                    continue
                off = (u - lines.uv[line, 0]) ** 2 + (v - lines.uv[line, 1]) ** 2
                known = lines.explained[line]
                if off <= reach * reach and (known == 0.0 or depth < known):
                    lines.explained[line] = depth


def explain(
    lines: Lines, points: np.ndarray, threads: int, radius: np.ndarray | None = None
) -> None:
    """Enter in ``lines.explained`` the depths of the points (n, 3) that lie on lines.

    Of balls with a ``radius`` (n,) wherever a line passes, of points where their pixel holds one.
    """
    radii = np.empty(0) if radius is None else radius
    in_parallel(lambda i: _explain(lines, points, radii, i), range(len(lines.starts)), threads)


def gather_lines(photos: ScanPhotos, clear_word: np.ndarray) -> Lines:
    """Find the lines of all photos of a scan; 4 bytes a pixel of all photos in memory.

    ``clear_word`` (n_views,) is what a photo's clear sky says, see `Lines`.
    """
    views, poses = photos.views, photos.poses
    sizes = np.array([(view.width, view.height) for view in views], dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(sizes.prod(axis=1))])
    maps = np.empty(starts[-1], dtype=np.int32)
    found, clear = [], []
    first = np.zeros(len(views) + 1, dtype=np.int64)
    with Progress(len(views), "photos searched for twigs before the sky") as bar:
        for i in range(len(views)):
            own = find_sky_lines(photos.photo(i), photos.raster(i), TOLERANCE_PX)
            maps[starts[i] : starts[i + 1]] = _line_map(own, first[i]).ravel()
            clear.append(own.clear.mean())
            offset = np.einsum("ni,ni->n", own.across, own.uv)
            normals = np.column_stack([own.across, -offset]) @ views[i].K @ views[i].R
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            found.append((own.uv, own.across, own.share, normals))
            first[i + 1] = first[i] + len(own.uv)
            bar.step()
    uv, across, share, plane = (np.concatenate(each) for each in zip(*found))
    return Lines(
        maps=maps,
        starts=starts[:-1],
        sizes=sizes,
        order=np.argsort(np.array(clear) * clear_word, kind="stable"),
        clear_word=np.asarray(clear_word, dtype=np.float64),
        projections=(poses.K @ poses.cam_from_world).reshape(-1, 12),
        focal=poses.K[:, 0, 0],
        centers=poses.centers,
        first=first,
        owner=np.repeat(np.arange(len(views)), np.diff(first)),
        uv=uv,
        across=across,
        plane=plane,
        surprise=-np.log(share),
        explained=np.zeros(len(share)),
    )


def _line_map(own: SkyLines, count: int) -> np.ndarray:
    """What each pixel shows, (height, width) int32; line points are numbered from ``count`` on.

    A line point holds its own pixel and those around it that hold none.
    """
    height, width = own.clear.shape
    out = np.where(own.clear, CLEAR, NOTHING).astype(np.int32)
    at = np.floor(own.uv).astype(int)
    around = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    for dx, dy in sorted(around, key=lambda offset: -abs(offset[0]) - abs(offset[1])):
        x, y = at[:, 0] + dx, at[:, 1] + dy
        inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        out[y[inside], x[inside]] = count + np.flatnonzero(inside)
    return out
