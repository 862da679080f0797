"""Fuse geometric depth maps into one cloud, without losing thin branches.

Every pixel that no earlier photo has explained starts a point; the photos that overlap most are
asked for their own depth there, and those that agree (reprojection error, depth, normal) are
averaged with it and count as explained. COLMAP's fusion does the same along chains of photos, with
normals within 10 degrees; normals of a branch three pixels wide are worth no more than about 60.
"""

from __future__ import annotations

import logging
import os
import tempfile
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.mvs.compiled import kernel, parallel_kernel, prange, use_threads
from cherrypicker.mvs.estimate import relative_projection
from cherrypicker.mvs.views import plan_views
from cherrypicker.mvs.workspace import View, Workspace
from cherrypicker.photos import read_photo
from cherrypicker.pointcloud import PointCloud, read_cloud
from cherrypicker.progress import Progress

logger = logging.getLogger(__name__)

_0 = np.float32(0.0)
_HALF = np.float32(0.5)
_1 = np.float32(1.0)
# Neighbour pixels whose depths differ by less are explained by one point
SAME_SURFACE = np.float32(0.003)


@dataclass(frozen=True)
class FusionOptions:
    """When two photos' depths are one point; the fields are config keys of the section ``mvs``."""

    min_views: int | None = None
    n_check: int = 20
    max_reproj_error_px: float = 2.0
    max_depth_error: float = 0.01
    max_normal_error_deg: float = 60.0

    def views_needed(self, n_photos: int) -> int:
        """Return ``min_views``, or its default: 2 below 20 photos, else 3."""
        if self.min_views is not None:
            return self.min_views
        return 2 if n_photos < 20 else 3


@kernel
def _explain(maps, used, others, rows, sizes, j, corner, depth):
    """Mark the four pixels around a match in photo ``j`` that lie on the same surface."""
    width = sizes[j, 0]
    for i in range(4):
        pixel = corner + (i & 1) + (i >> 1) * width
        if pixel < 0 or pixel >= width * sizes[j, 1]:
            continue
        if abs(maps[others[j], pixel, 3] - depth) < SAME_SURFACE * depth:
            used[rows[j], pixel] = 1


@parallel_kernel
def _fuse_view(
    maps,
    used,
    slot,
    others,
    rows,
    sizes,
    forward,
    back,
    rotations,
    ray,
    limits,
    min_views,
    out,
    counts,
):
    """Fuse one reference's pixels.

    Parameters
    ----------
    maps : ndarray of shape (n_slots, n_pixels, 4), float32
        Normals and depth of the photos at hand, each in its own camera.
    used : ndarray of shape (n_views, n_pixels), uint8
        Pixels explained; those of the matching pixels are set. The same value may be written by
        two threads, which is harmless, and nothing but the reference's own row is read.
    others, rows, sizes, forward, back, rotations : ndarray
        Slots, rows of ``used``, sizes, projections and rotations of the overlapping photos.
    ray : tuple of float32
        Reference's fx, fy, cx, cy (pixel centres at whole numbers).
    limits : tuple of float32
        Reprojection error (px), relative depth error, cosine of the normals' angle.
    out : ndarray of shape (n_pixels, 6), float32
        Filled with position and normal in the reference's camera.
    counts : ndarray of shape (n_pixels,), uint8
        Filled with the number of photos, 0 where there is no point.
    """
    width = sizes[0, 0]
    height = sizes[0, 1]
    n = others.shape[0]
    max_error = limits[0] * limits[0]
    for y in prange(height):
        xs = np.empty((4, n), np.float32)
        matched = np.empty((n, 2), np.int64)
        fy = np.float32(y)
        for x in range(width):
            pixel = y * width + x
            counts[pixel] = 0
            depth = maps[slot, pixel, 3]
            if depth <= _0 or used[rows[0], pixel] != 0:
                continue
            fx = np.float32(x)
            w = _1 / depth
            nx = maps[slot, pixel, 0]
            ny = maps[slot, pixel, 1]
            nz = maps[slot, pixel, 2]
            ax = nx
            ay = ny
            az = nz
            xs[0, 0] = (fx - ray[2]) / ray[0] * depth
            xs[1, 0] = (fy - ray[3]) / ray[1] * depth
            xs[2, 0] = depth
            m = 1
            for j in range(1, n):
                P = forward[j]
                z = P[6] * fx + P[7] * fy + P[8] + P[11] * w
                if z <= np.float32(1e-6):
                    continue
                u = (P[0] * fx + P[1] * fy + P[2] + P[9] * w) / z
                v = (P[3] * fx + P[4] * fy + P[5] + P[10] * w) / z
                iu = np.int64(np.floor(u + _HALF))
                iv = np.int64(np.floor(v + _HALF))
                if iu < 0 or iv < 0 or iu >= sizes[j, 0] or iv >= sizes[j, 1]:
                    continue
                other = iv * sizes[j, 0] + iu
                found = maps[others[j], other, 3]
                if found <= _0:
                    continue
                expected = z * depth
                if abs(found - expected) > limits[1] * expected:
                    continue
                B = back[j]
                fu = np.float32(iu)
                fv = np.float32(iv)
                wj = _1 / found
                zb = B[6] * u + B[7] * v + B[8] + B[11] * wj
                ex = (B[0] * u + B[1] * v + B[2] + B[9] * wj) / zb - fx
                ey = (B[3] * u + B[4] * v + B[5] + B[10] * wj) / zb - fy
                if ex * ex + ey * ey > max_error:
                    continue
                R = rotations[j]
                mx = maps[others[j], other, 0]
                my = maps[others[j], other, 1]
                mz = maps[others[j], other, 2]
                rx = R[0] * mx + R[1] * my + R[2] * mz
                ry = R[3] * mx + R[4] * my + R[5] * mz
                rz = R[6] * mx + R[7] * my + R[8] * mz
                if rx * nx + ry * ny + rz * nz < limits[2]:
                    continue
                zc = B[6] * fu + B[7] * fv + B[8] + B[11] * wj
                xc = (B[0] * fu + B[1] * fv + B[2] + B[9] * wj) / zc
                yc = (B[3] * fu + B[4] * fv + B[5] + B[10] * wj) / zc
                dc = zc * found
                xs[0, m] = (xc - ray[2]) / ray[0] * dc
                xs[1, m] = (yc - ray[3]) / ray[1] * dc
                xs[2, m] = dc
                xs[3, m] = found
                ax += rx
                ay += ry
                az += rz
                matched[m, 0] = j
                matched[m, 1] = np.int64(np.floor(v)) * sizes[j, 0] + np.int64(np.floor(u))
                m += 1
            if m < min_views:
                continue
            for i in range(1, m):
                _explain(maps, used, others, rows, sizes, matched[i, 0], matched[i, 1], xs[3, i])
            counts[pixel] = min(m, 255)
            for c in range(3):
                out[pixel, c] = np.median(xs[c, :m])
            length = np.sqrt(ax * ax + ay * ay + az * az) + np.float32(1e-12)
            out[pixel, 3] = ax / length
            out[pixel, 4] = ay / length
            out[pixel, 5] = az / length


class _MapSlots:
    """Depth and normal maps of the photos in use, in a fixed block of memory."""

    def __init__(self, workspace: Workspace, kind: str, capacity: int):
        self._workspace = workspace
        self._kind = kind
        n_pixels = max(view.width * view.height for view in workspace.views)
        self.maps = np.zeros((capacity, n_pixels, 4), dtype=np.float32)
        self._slots: OrderedDict[int, int] = OrderedDict()

    def load(self, indices: list[int]) -> np.ndarray:
        """Return the slots of these views, reading those that are not there."""
        for i in indices:
            if i in self._slots:
                self._slots.move_to_end(i)
        for i in indices:
            if i not in self._slots:
                slot = len(self._slots)
                if slot == len(self.maps):
                    _, slot = self._slots.popitem(last=False)
                self._read(i, slot)
                self._slots[i] = slot
        return np.array([self._slots[i] for i in indices], dtype=np.int64)

    def _read(self, i: int, slot: int) -> None:
        view = self._workspace.views[i]
        n = view.width * view.height
        self.maps[slot, :n, 3] = self._workspace.read_depth(view, self._kind).ravel()
        self.maps[slot, :n, :3] = self._workspace.read_normals(view, self._kind).reshape(-1, 3)


def fuse(
    workspace: Workspace,
    names: list[str],
    overlaps: dict[int, list[int]],
    options: FusionOptions,
    *,
    threads: int = 1,
    kind: str = "geometric",
) -> PointCloud:
    """Fuse the depth maps of a workspace.

    Parameters
    ----------
    workspace : Workspace
        With maps of every photo in ``names``.
    names : list of str
        Photos to fuse.
    overlaps : dict
        View index to the views that overlap most, best first.
    options : FusionOptions
        Limits.
    threads : int
        Threads of the kernels.

    Returns
    -------
    PointCloud
        In COLMAP's frame, with colours, normals and the number of photos ``n_views`` (uint8).

    Raises
    ------
    StageError
        If no point is seen consistently by ``min_views`` photos.
    """
    use_threads(threads)
    views = workspace.views
    chosen = [i for i, view in enumerate(views) if view.name in set(names)]
    row_of = {i: row for row, i in enumerate(chosen)}
    slots = _MapSlots(workspace, kind, min(options.n_check + 1, len(chosen)))
    used = np.zeros((len(chosen), slots.maps.shape[1]), dtype=np.uint8)
    parts = []
    with Progress(len(chosen), "photos fused") as bar:
        for i in chosen:
            group = [i] + [j for j in overlaps[i] if j in row_of and j != i][: options.n_check]
            rows = np.array([row_of[j] for j in group], dtype=np.int64)
            parts.append(_fuse_one(workspace, slots, used, group, rows, options))
            bar.step()
    cloud = PointCloud(
        points=np.concatenate([part[0] for part in parts]),
        normals=np.concatenate([part[1] for part in parts]),
        colors=np.concatenate([part[2] for part in parts]),
        fields={"n_views": np.concatenate([part[3] for part in parts])},
        frame="colmap",
        unit="arbitrary",
    )
    if len(cloud) == 0:
        raise StageError(
            f"no point is seen consistently by {options.views_needed(len(chosen))} photos",
            file=workspace.folder,
            key="mvs.min_views, mvs.max_depth_error",
        )
    logger.info(
        "fused %d photos into %s points, %.1f photos a point in the mean",
        len(chosen),
        f"{len(cloud):,}",
        float(cloud["n_views"].mean()),
    )
    return cloud


def _kernel_intrinsics(view: View) -> np.ndarray:
    K = view.K.copy()
    K[:2, 2] -= 0.5
    return K


def _fuse_one(workspace, slots, used, group, rows, options):
    """Return points, normals, colours and counts of one reference, world frame."""
    views = [workspace.views[j] for j in group]
    reference = views[0]
    at = slots.load(group)
    poses = [(_kernel_intrinsics(view), view.R, view.t) for view in views]
    forward = np.array([relative_projection(poses[0], p) for p in poses], dtype=np.float32)
    back = np.array([relative_projection(p, poses[0]) for p in poses], dtype=np.float32)
    turns = np.array([(reference.R @ view.R.T).ravel() for view in views], dtype=np.float32)
    sizes = np.array([(view.width, view.height) for view in views], dtype=np.int64)
    K = poses[0][0].astype(np.float32)
    limits = (
        np.float32(options.max_reproj_error_px),
        np.float32(options.max_depth_error),
        np.float32(np.cos(np.radians(options.max_normal_error_deg))),
    )
    n_pixels = reference.width * reference.height
    out = np.empty((n_pixels, 6), dtype=np.float32)
    counts = np.empty(n_pixels, dtype=np.uint8)
    _fuse_view(
        slots.maps, used, int(at[0]), at, rows, sizes, forward, back, turns,
        (K[0, 0], K[1, 1], K[0, 2], K[1, 2]), limits, options.views_needed(len(used)), out, counts,
    )  # fmt: skip
    kept = np.flatnonzero(counts)
    points = (out[kept, :3].astype(np.float64) - reference.t) @ reference.R
    normals = (out[kept, 3:].astype(np.float64) @ reference.R).astype(np.float32)
    photo = read_photo(workspace.photo_path(reference)).reshape(-1, 3)
    return points, normals, photo[kept].astype(np.float32) / 255.0, counts[kept]


def fuse_workspace(
    folder: str | os.PathLike,
    names: list[str],
    options: FusionOptions,
    *,
    method: str = "star",
    threads: int = 1,
    kind: str = "geometric",
) -> PointCloud:
    """Fuse a workspace's depth maps with our fusion ("star") or COLMAP's ("colmap").

    Parameters and errors as :func:`fuse`; COLMAP's fusion knows ``n_views`` too.
    """
    workspace = Workspace(folder)
    if method == "star":
        overlaps = {p.view: list(p.sources) for p in plan_views(workspace, options.n_check)}
        return fuse(workspace, names, overlaps, options, threads=threads, kind=kind)
    if method == "colmap":
        return _fuse_with_colmap(workspace, options, threads, kind)
    raise StageError(f"unknown fusion {method!r}, one of star, colmap", key="mvs.fusion")


def _fuse_with_colmap(
    workspace: Workspace, options: FusionOptions, threads: int, kind: str
) -> PointCloud:
    settings = pycolmap.StereoFusionOptions()
    settings.num_threads = threads
    settings.min_num_pixels = options.views_needed(len(workspace.views))
    settings.check_num_images = options.n_check
    settings.max_reproj_error = options.max_reproj_error_px
    settings.max_depth_error = options.max_depth_error
    settings.max_normal_error = options.max_normal_error_deg
    with tempfile.TemporaryDirectory(dir=workspace.folder) as scratch:
        path = Path(scratch) / "fused.ply"
        pycolmap.stereo_fusion(
            path, workspace.folder, input_type=kind, options=settings, output_type="ply"
        )
        cloud = read_cloud(path)
        n_views = _read_visibility(Path(f"{path}.vis"), len(cloud))
    cloud = PointCloud(points=cloud.points, colors=cloud.colors, normals=cloud.normals)
    cloud.frame, cloud.unit = "colmap", "arbitrary"
    logger.info("COLMAP fused %s points", f"{len(cloud):,}")
    return cloud if n_views is None else cloud.with_fields(n_views=n_views)


def _read_visibility(path: Path, n_points: int) -> np.ndarray | None:
    """Number of photos of each point from COLMAP's .vis file, None where it wrote none."""
    if not path.exists():
        return None
    content = path.read_bytes()
    if int(np.frombuffer(content, "<u8", 1)[0]) != n_points:
        return None
    words = np.frombuffer(content, "<u4", offset=8)
    counts, at = np.empty(n_points, dtype=np.uint8), 0
    for i in range(n_points):
        counts[i] = min(int(words[at]), 255)
        at += 1 + int(words[at])
    return counts
