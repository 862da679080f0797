"""The photos of a scan for the 3D view: where each was taken, and a small picture of it."""

import io
import logging
from collections.abc import Callable
from contextlib import suppress

import numpy as np
from PIL import Image

from cherrypicker.errors import StageError
from cherrypicker.poses import Poses
from cherrypicker.report.style import LAYOUT
from cherrypicker.report.text import data_url

logger = logging.getLogger(__name__)

_LONGEST_PX = int(LAYOUT["tile_px"])  # of a picture
_BUDGET = 3_000_000  # bytes of all pictures; beyond, every second, third ... photo has one


def camera_views(
    poses: Poses, read: Callable[[str, int], np.ndarray] | None, pictures: dict[str, str]
) -> list[dict]:
    """Return the cameras of the view.

    Poses are those of the undistorted photos, in the skeleton's frame. ``read`` takes a photo's
    name and its longer side, px, and returns it undistorted; ``pictures`` are the ids of photos'
    figures on the page.

    Each has ``name``, ``center``, ``rays`` (unit directions of the corners), ``size`` (px of the
    picture), ``matrix`` (3, 4; from the frame to px of the picture), ``photo`` (its address, empty
    where it has no picture) and ``picture`` (the figure's id, or empty).
    """
    files: dict[str, bytes] = {}
    for view in poses:
        with suppress(StageError), io.BytesIO() as stream:  # one that cannot be read has no picture
            if read:
                picture = Image.fromarray(read(view.name, _LONGEST_PX))
                picture.save(stream, "JPEG")
                files[view.name] = stream.getvalue()
    step = -(-sum(map(len, files.values())) // _BUDGET) or 1
    if step > 1:
        logger.info("every %dth photo has a picture in the view", step)
    shown = {name: data_url("image/jpeg", files[name]) for name in list(files)[::step]}
    views = []
    for i, view in enumerate(poses):
        wide, tall = view.width, view.height
        zoom = _LONGEST_PX / max(wide, tall)
        rays = view.rays(np.array([[0, 0], [wide, 0], [wide, tall], [0, tall]]))
        views.append(
            {
                "name": view.name,
                "center": poses.centers[i],
                "rays": np.round(rays / np.linalg.norm(rays, axis=1)[:, None], 4).tolist(),
                "size": [round(zoom * wide), round(zoom * tall)],
                "matrix": np.diag([zoom, zoom, 1.0]) @ poses.K[i] @ poses.cam_from_world[i],
                "photo": shown.get(view.name, ""),
                "picture": pictures.get(view.name, ""),
            }
        )
    return views
