"""Crops of photos around the markers, with the corners that the scale rests on drawn in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from cherrypicker.photos import UNREADABLE
from cherrypicker.poses import Poses
from cherrypicker.report.figures import tile_grid
from cherrypicker.report.style import LAYOUT

_REACH, _LEAST_REACH_PX = 0.9, 8.0  # of a marker's width in the photo, around its middle


def marker_crops(
    scale: dict, poses: Poses, lenses: Any, *, n_photos: int = 3, n_markers: int = 3
) -> list:
    """Choose the photos that show each used marker largest.

    Parameters
    ----------
    scale : dict
        ``scale.json`` with markers' ``corners`` (4, 3) in the frame of `poses` and ``images``.
    poses : Poses
        In COLMAP's frame.
    lenses : PhotoLenses
        Of the same photos in the same order.
    n_photos, n_markers : int
        Most photos a marker, most markers.

    Returns
    -------
    list of list of tuple (int, str, ndarray of shape (4, 2))
        Per marker: its id, the photo's name and the corners in its pixels.
    """
    index = {str(name): i for i, name in enumerate(poses.names)}
    markers = [m for m in scale.get("markers") or [] if m.get("used") and m.get("corners")]
    chosen = []
    for marker in markers[:n_markers]:
        corners = np.asarray(marker["corners"], dtype=np.float64)
        crops = []
        for name in marker.get("images") or []:
            i = index.get(str(name))
            if i is None:
                continue
            in_camera = corners @ poses.rotations[i].T + poses.cam_from_world[i, :, 3]
            if (in_camera[:, 2] > 0).all():
                crops.append((marker["id"], str(name), lenses.to_photo(i, in_camera)))
        crops.sort(key=lambda crop: (-np.ptp(crop[2], axis=0).prod(), crop[1]))
        if crops:
            chosen.append(crops[:n_photos])
    return chosen


def marker_figure(scale: dict, poses: Poses, lenses: Any, photos: list[Path]) -> Figure | None:
    """The markers as the photos show them.

    Parameters
    ----------
    scale, poses, lenses
        See `marker_crops`.

    Returns
    -------
    Figure or None
        None without a marker in a readable photo.
    """
    paths = {path.name: path for path in photos}
    rows = [
        [
            tile
            for marker, name, corners in crops
            if name in paths and (tile := _tile(f"marker {marker}: {name}", paths[name], corners))
        ]
        for crops in marker_crops(scale, poses, lenses)
    ]
    return tile_grid(rows, (LAYOUT["marker_width"], LAYOUT["marker_height"]))


def _tile(title: str, path: Path, corners: np.ndarray) -> tuple | None:
    """A tile of `tile_grid` around the corners; None of an unreadable photo."""
    middle = corners.mean(axis=0)
    half = max(_REACH * float(np.ptp(corners, axis=0).max()), _LEAST_REACH_PX)
    try:
        with Image.open(path) as image:
            low = np.maximum(np.floor(middle - half), 0).astype(int)
            high = np.minimum(np.ceil(middle + half), image.size).astype(int)
            if (high - low < 2).any():
                return None
            zoom = LAYOUT["marker_px"] / float((high - low).max())
            wide, tall = (max(int(round(side * zoom)), 1) for side in high - low)
            tile = image.convert("RGB").crop((*low, *high)).resize((wide, tall))
    except UNREADABLE:
        return None
    return title, tile, {}, (np.vstack([corners, corners[:1]]) - low) * zoom - 0.5
