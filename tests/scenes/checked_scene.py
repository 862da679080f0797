"""A small tree before the sky, drawn with exact masks, as a dense workspace with its skeleton."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image
from sky_scene import BARK, Rod, draw, ring

from cherrypicker.classes import Label
from cherrypicker.mvs.raster import SkyMasks, write_rasters
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.mvs.undistort import UndistortedPhotos
from cherrypicker.photos import list_photos
from cherrypicker.poses import Poses
from cherrypicker.skeleton.model import Skeleton

STEM = Rod((0.0, 0.0, 0.70), (0.0, 0.0, 1.45), 0.012, BARK)
#: Start on the stem, end, radius.
TWIGS = tuple(
    Rod(
        (0.0, 0.0, height),
        (reach * np.cos(turn), reach * np.sin(turn), height + 0.12),
        radius,
        BARK,
    )
    for height, turn, reach, radius in (
        (1.08, 0.3, 0.30, 0.004),
        (1.15, 2.2, 0.28, 0.003),
        (1.22, 4.1, 0.26, 0.003),
        (1.29, 5.4, 0.22, 0.002),
        (1.36, 1.3, 0.18, 0.002),
    )
)
STEP = 0.01


def write_scan(folder: Path, rods: tuple = (STEM, *TWIGS), n_views: int = 16) -> Poses:
    """Write ``dense`` (photos and cameras, which are those of the sparse model too) and ``sky``."""
    poses = ring(n_views)
    width, height = int(poses.width[0]), int(poses.height[0])
    K = poses.K[0]
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(
            camera_id=1,
            model="PINHOLE",
            width=width,
            height=height,
            params=[K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
        )
    )
    poses.names = np.array([f"{i:02d}.png" for i in range(n_views)])
    for part in ("dense/images", "dense/sparse", "sky"):
        (folder / part).mkdir(parents=True)
    for i, name in enumerate(poses.names):
        image = pycolmap.Image(name=str(name), camera_id=1, image_id=i + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(poses.cam_from_world[i]))
        photo, free = draw(poses, i, rods, "overcast")
        Image.fromarray(photo).save(folder / "dense/images" / str(name))
        Image.fromarray(free.astype(np.uint8) * 255).save(folder / "sky" / str(name))
    model.write(folder / "dense/sparse")
    return poses


def open_scan(folder: Path) -> ScanPhotos:
    """Write the scan and open it as the stages do."""
    poses = write_scan(folder)
    masks = SkyMasks(folder / "sky", folder / "dense/sparse")
    write_rasters(folder / "dense/images", poses, masks, folder / "evidence")
    images = UndistortedPhotos(folder / "dense/sparse", list_photos(folder / "dense/images"))
    return ScanPhotos(poses, folder / "evidence", read_photo=images.read)


def skeleton_of(rods: tuple) -> Skeleton:
    """The axes of rods, the first of them the stem, sampled evenly."""
    points, parent, radius = [], [], []
    for rod in rods:
        start, end = np.array(rod.start), np.array(rod.end)
        n = round(np.linalg.norm(end - start) / STEP)
        own = start + np.linspace(0, 1, n + 1)[:, None] * (end - start)
        first = len(parent)
        if first:
            stem = np.array(points[: round(0.75 / STEP) + 1])
            parent.append(int(np.linalg.norm(stem - own[1], axis=1).argmin()))
            own = own[1:]
        else:
            parent.append(-1)
        parent += range(first, first + len(own) - 1)
        points += list(own)
        radius += [rod.radius] * len(own)
    n = len(points)
    return Skeleton(np.array(points), np.array(parent), np.array(radius), np.full(n, Label.BRANCH))
