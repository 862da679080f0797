"""A small scene with exact depth, ray traced: textured planes and a thin upright cylinder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image
from scipy.ndimage import gaussian_filter


@dataclass
class Surface:
    """A plane ``normal . x = offset`` or, with a radius, a cylinder along y through ``center``."""

    normal: tuple = (0.0, 0.0, 1.0)
    offset: float = 4.0
    center: tuple = (0.0, 0.0, 0.0)
    radius: float = 0.0
    seed: int = 0
    texels_per_m: float = 100.0

    def hit(self, origin, rays):
        """Distance along each ray (n,), inf where it misses."""
        if self.radius == 0.0:
            normal = np.asarray(self.normal)
            along = (self.offset - normal @ origin) / (rays @ normal)
            return np.where(along > 0.0, along, np.inf)
        o = origin[[0, 2]] - np.asarray(self.center)[[0, 2]]
        d = rays[:, [0, 2]]
        a, b = (d**2).sum(axis=1), d @ o
        inside = b**2 - a * (o @ o - self.radius**2)
        with np.errstate(invalid="ignore"):
            return np.where(inside > 0.0, (-b - np.sqrt(inside)) / a, np.inf)

    def shade(self, points):
        """Grey value (n,) of smooth noise over the surface, pinned to the world."""
        if self.radius == 0.0:
            u, v = points[:, 0], points[:, 1]
        else:
            turn = np.arctan2(points[:, 0] - self.center[0], points[:, 2] - self.center[2])
            u, v = turn * self.radius, points[:, 1]
        texture = _texture(self.seed)
        size = texture.shape[0]
        x, y = (u * self.texels_per_m) % (size - 1), (v * self.texels_per_m) % (size - 1)
        x0, y0 = x.astype(int), y.astype(int)
        fx, fy = x - x0, y - y0
        top = texture[y0, x0] * (1 - fx) + texture[y0, x0 + 1] * fx
        bottom = texture[y0 + 1, x0] * (1 - fx) + texture[y0 + 1, x0 + 1] * fx
        return top * (1 - fy) + bottom * fy


def _texture(seed):
    noise = np.random.default_rng(seed).normal(size=(512, 512))
    smooth = gaussian_filter(noise, 1.5, mode="wrap")
    base = 150.0 if seed % 2 == 0 else 60.0
    return np.clip(base + 35.0 * smooth / smooth.std(), 0, 255)


def render(surfaces, K, R, t, width, height):
    """Return photo (height, width, 3) uint8 and depth (height, width), 0 where nothing is hit."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], axis=-1)
    rays = rays.reshape(-1, 3) @ R
    origin = -R.T @ t
    hits = np.array([surface.hit(origin, rays) for surface in surfaces])
    nearest = hits.argmin(axis=0)
    depth = hits.min(axis=0)
    grey = np.full(len(rays), 230.0)
    for i, surface in enumerate(surfaces):
        mine = (nearest == i) & np.isfinite(depth)
        grey[mine] = surface.shade(origin + rays[mine] * depth[mine, None])
    photo = np.repeat(np.rint(grey).astype(np.uint8).reshape(height, width, 1), 3, axis=2)
    return photo, np.where(np.isfinite(depth), depth, 0.0).reshape(height, width)


def write_scene(
    folder: Path, surfaces, *, n_views=5, width=160, height=120, n_points=200, points_within=np.inf
):
    """Write a dense workspace of a row of cameras around z; return the true depth of each photo.

    Sparse points are no deeper than `points_within` in the middle photo.
    """
    K = np.array([[150.0, 0.0, width / 2], [0.0, 150.0, height / 2], [0.0, 0.0, 1.0]])
    model = pycolmap.Reconstruction()
    parameters = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=1, model="PINHOLE", width=width, height=height, params=parameters)
    )
    (folder / "images").mkdir(parents=True)
    (folder / "sparse").mkdir()
    poses, depths = [], []
    for i in range(n_views):
        angle = np.radians(6.0 * (i - (n_views - 1) / 2))
        R = np.array(
            [
                [np.cos(angle), 0.0, np.sin(angle)],
                [0.0, 1.0, 0.0],
                [-np.sin(angle), 0.0, np.cos(angle)],
            ]
        )
        center = np.array([0.0, 0.05 * (-1) ** i, 4.0]) - 4.0 * R[2]
        poses.append((R, -R @ center))
        photo, depth = render(surfaces, K, *poses[-1], width, height)
        Image.fromarray(photo).save(folder / "images" / f"view{i}.png")
        depths.append(depth)
    _add_points(model, K, poses, depths, n_points, points_within)
    model.write(folder / "sparse")
    return K, poses, depths


def _add_points(model, K, poses, depths, n_points, points_within):
    height, width = depths[0].shape
    rng = np.random.default_rng(0)
    rows, columns = rng.integers(8, height - 8, n_points), rng.integers(8, width - 8, n_points)
    R, t = poses[len(poses) // 2]
    z = depths[len(poses) // 2][rows, columns]
    keep = (z > 0.0) & (z <= points_within)
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(n_points)])[:, keep]
    points = ((np.linalg.inv(K) @ pixels * z[keep]).T - t) @ R
    for i, (R_i, t_i) in enumerate(poses):
        image = pycolmap.Image(name=f"view{i}.png", camera_id=1, image_id=i + 1)
        projected = (points @ R_i.T + t_i) @ K.T
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(p[:2] / p[2]) for p in projected])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.c_[R_i, t_i]))
    for j, point in enumerate(points):
        track = pycolmap.Track()
        for i in range(len(poses)):
            track.add_element(i + 1, j)
        model.add_point3D(point, track, np.array([128, 128, 128], dtype=np.uint8))
