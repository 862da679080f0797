"""Buds that were found, against those of a scene."""

from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from cherrypicker.bearing.buds import BUD_M, STEP_M, Buds
from cherrypicker.files import read_table
from cherrypicker.mvs.raster import make_raster
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.photo_check.places import places_along
from cherrypicker.photos import read_photo
from cherrypicker.poses import read_poses
from cherrypicker.sky.mask_files import write_mask
from cherrypicker_lab.orchard.render.photo import SKY_ID

# A found bud is a true one within so much, m
TOLERANCE_M = 0.01


def score_buds(skeleton, buds: Buds, truth) -> dict:
    """Compare buds that were found on a skeleton with ``buds.csv`` in the folder ``truth``.

    Returns ``told_m``, the length on which they are told, ``n_true``, those of the scene there but
    for the last of an axis, ``n_right``, those of them that are found, and ``n_false``, those found
    that are none of the scene.
    """
    rows = [row for _, row in read_table(Path(truth) / "buds.csv")]
    true = np.array([[float(row[name]) for name in "xyz"] for row in rows])
    is_last = np.array([row["is_last"] == "1" for row in rows])
    places = places_along(skeleton, STEP_M)
    is_told = buds.told_m[places.node] > 0.5 * skeleton.edge_length[places.node]
    there = np.zeros(len(true), dtype=bool)
    if is_told.any():
        there = cKDTree(places.points[is_told]).query(true)[0] < BUD_M
    found = np.array([[row[name] for name in "xyz"] for row in buds.found]).reshape(-1, 3)
    apart = np.linalg.norm(found[:, None] - true[None], axis=2)
    rows, columns = linear_sum_assignment(np.where(apart < TOLERANCE_M, apart, 1.0))
    matched = columns[apart[rows, columns] < TOLERANCE_M]
    return {
        "told_m": round(float(buds.told_m.sum()), 3),
        "n_true": int((there & ~is_last).sum()),
        "n_right": int((there & ~is_last)[matched].sum()),
        "n_false": len(found) - len(matched),
    }


def close_ups(scene, halvings: int, folder) -> ScanPhotos:
    """Photos of a rendered scene by its true cameras and sky, halved so many times.

    What they show is written into a folder.
    """
    scene, folder, factor = Path(scene), Path(folder), 2**halvings
    poses = read_poses(scene / "truth" / "poses.npz")
    poses = poses.resized(poses.width // factor, poses.height // factor)
    photos = {}
    for view in poses:
        mask = f"{Path(view.name).stem}.png"
        classes = cv2.imread(str(scene / "truth" / "semantic" / mask), cv2.IMREAD_GRAYSCALE)
        seen = read_photo(scene / "photos" / view.name), 255 * (classes == SKY_ID).astype(np.uint8)
        size = view.width, view.height
        photo, sky = (cv2.resize(each, size, interpolation=cv2.INTER_AREA) for each in seen)
        photos[view.name] = photo
        write_mask(folder / mask, make_raster(photo, sky > 127, np.zeros(sky.shape, dtype=bool)))
    return ScanPhotos(poses, folder, read_photo=lambda name, _: photos[name])
