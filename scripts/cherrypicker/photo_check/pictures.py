"""A photo beside itself with the skeleton drawn over it, in the colours of the photos' verdict."""

import os

import cv2
import numpy as np
from PIL import Image, ImageColor

from cherrypicker.evidence.existence import Existence
from cherrypicker.files import atomic_path
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.photo_check.places import Places

# What is there, what no photo can judge, what is not there, is missing, or was not and is dropped
THERE, UNJUDGED, REFUTED, MISSING, DROPPED = map(
    ImageColor.getrgb, ("forestgreen", "royalblue", "red", "orange", "darkorchid")
)
# Beyond the tree's box, as a share of its larger side
MARGIN = 0.06
# Coordinates of OpenCV's drawing in sixteenths of a pixel
SHIFT = 4


def draw_verdict(
    photos: ScanPhotos,
    i: int,
    places: Places,
    tree: Existence,
    missing: np.ndarray,
    dropped: np.ndarray,
) -> np.ndarray:
    """Draw photo ``i`` and, beside it, the skeleton's tubes and what is missing over it, upright.

    What the photos say of the places is ``tree``; places (n, 3) are missing. Lower end, upper end
    and radius of what the skeleton no longer has are ``dropped`` (n_edges, 7). The picture is
    (height, width, 3) uint8.
    """
    view = photos.views[i]
    photo = photos.photo(i)
    uv, depth = view.project(places.points)
    also, far = view.project(missing)
    low, high = _box(uv[depth > 0], photo.shape)
    part = photo[low[1] : high[1], low[0] : high[0]]
    drawn = (part // 2 + 127).astype(np.uint8)
    radius = np.maximum(places.radius * view.K[0, 0] / np.maximum(depth, 1e-9), 1.0)
    at = _fixed(uv - low)
    kinds = np.where(tree.probability < 0.5, 2, np.where(tree.told >= 0.5, 0, 1))
    for kind, color in ((1, UNJUDGED), (0, THERE), (2, REFUTED)):
        for row in np.flatnonzero((kinds == kind) & (depth > 0)):
            _dot(drawn, at[row], radius[row], color)
    (low_end, front), (high_end, back) = (view.project(dropped[:, at : at + 3]) for at in (0, 3))
    ends = _fixed(np.hstack([low_end, high_end]) - np.tile(low, 2))
    for x, y, u, v in ends[(front > 0) & (back > 0)].tolist():
        cv2.line(drawn, (x, y), (u, v), DROPPED, lineType=cv2.LINE_AA, shift=SHIFT)
    for place in _fixed(also[far > 0] - low):
        _dot(drawn, place, 1.0, MISSING)
    turns = quarter_turns(view.R)
    return np.hstack([np.rot90(part, turns), np.rot90(drawn, turns)])


def quarter_turns(rotation: np.ndarray) -> int:
    """Count the counter-clockwise quarter turns that bring a photo upright.

    The rotation (3, 3) is from the world, z up, to the camera, x right and y down.
    """
    right, down = rotation[:2, 2]  # where up points in the photo
    return int(np.rint(np.arctan2(right, -down) / (np.pi / 2))) % 4


def _box(uv: np.ndarray, shape: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Corners (x, y) of the part of a photo that holds the tree, whole pixels."""
    size = np.array(shape[1::-1])
    seen = uv[((uv >= 0) & (uv < size)).all(axis=1)]
    if not len(seen):
        return np.zeros(2, int), size
    margin = MARGIN * np.ptp(seen, axis=0).max() + 1
    low, high = seen.min(axis=0) - margin, seen.max(axis=0) + margin
    return np.maximum(low, 0).astype(int), np.minimum(high + 1, size).astype(int)


def _fixed(places: np.ndarray) -> np.ndarray:
    """Pixels as OpenCV's drawing takes them: from the first pixel's centre, in fractions."""
    return np.rint((places - 0.5) * 2**SHIFT).astype(np.int32)


def _dot(image: np.ndarray, at: np.ndarray, radius: float, color: tuple) -> None:
    x, y = map(int, at)
    cv2.circle(image, (x, y), round(radius * 2**SHIFT), color, cv2.FILLED, cv2.LINE_AA, SHIFT)


def write_picture(path: str | os.PathLike, picture: np.ndarray) -> None:
    """Write a picture (height, width, 3) uint8 as JPEG, atomically."""
    with atomic_path(path) as temporary:
        Image.fromarray(picture).save(temporary, format="JPEG")
