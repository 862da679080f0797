"""One look at each photo at reduced size: blur, exposure, markers, features, a thumbnail."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from PIL import ExifTags, Image, ImageOps

from cherrypicker.errors import StageError
from cherrypicker.intake.stills import shrunk
from cherrypicker.markers.detection import find_markers
from cherrypicker.photos import (
    LONGEST_FOCAL_MM,
    UNREADABLE,
    check_promise,
    exif_camera,
    exif_orientation,
)
from cherrypicker.progress import in_threads
from cherrypicker.sfm.features import FeatureOptions
from cherrypicker.sfm.photo_files import PhotoInfo

LOOK_PX = FeatureOptions.max_image_size_px  # longer side of what is looked at
# Longer sides, px: of what features come from, and of the picture on the contact sheet
FEATURE_PX, THUMBNAIL_PX = 1000, 240
N_FEATURES = 1200
_BLUR_REACH = 11  # px, Crete et al.'s own
# Grey values from which on a pixel counts as burnt out, and up to which as black (guess)
_WHITE, _BLACK = 250, 5
# Focal length of a photo that does not tell it, in its longer sides
_FOCAL_SHARE = pycolmap.ImageReaderOptions().default_focal_length_factor
_FULL_FRAME_MM = 36.0


@dataclass(frozen=True)
class Look(PhotoInfo):
    """What one look at a photo tells."""

    blur: float = 0.0  # 0 sharp to 1
    brightness: float = 0.0  # mean of what is neither burnt out nor black, in stops below white
    # burnt, black: shares of the pixels
    burnt: float = 0.0
    black: float = 0.0
    marker_ids: list[int] = field(default_factory=list)
    # (n_features, 2) float32: from the photo's middle, in focal lengths
    corners: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    # (n_features, 128) float32: unit square-rooted SIFT
    descriptors: np.ndarray = field(default_factory=lambda: np.zeros((0, 128), np.float32))
    # (height, width, 3) uint8: RGB, upright
    thumbnail: np.ndarray = field(default_factory=lambda: np.zeros((1, 1, 3), np.uint8))


def look_at(
    photos: Sequence[Path], dictionaries: Mapping[str, cv2.aruco.Dictionary], threads: int
) -> Iterator[Look]:
    """Yield a look at each photo, in their order, `threads` at a time, and for these markers."""
    return in_threads(lambda path: _look(path, dictionaries), photos, threads, "photos looked at")


def _look(path: Path, dictionaries: Mapping[str, cv2.aruco.Dictionary]) -> Look:
    try:
        with Image.open(path) as image:
            details = image.getexif().get_ifd(ExifTags.IFD.Exif)
            focal_35 = float(details.get(ExifTags.Base.FocalLengthIn35mmFilm) or 0.0)
            size = image.size
            check_promise(image, path)
            image.draft("RGB", (LOOK_PX, LOOK_PX))
            upright = ImageOps.exif_transpose(image.convert("RGB"))
    except StageError as error:
        return Look(path, problem=error.cause)
    except UNREADABLE as error:
        return Look(path, problem=f"cannot be read ({error})")
    upright.thumbnail((LOOK_PX, LOOK_PX), Image.Resampling.BOX)
    color = np.asarray(upright)
    grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    focal = focal_35 / _FULL_FRAME_MM if 0.0 < focal_35 < LONGEST_FOCAL_MM else _FOCAL_SHARE
    small, corners, descriptors = _features(grey)
    middle = 0.5 * np.array(small.shape[::-1])
    middling = grey[(grey < _WHITE) & (grey > _BLACK)]
    return Look(
        path,
        *size,
        *exif_camera(path),
        exif_orientation(path),
        digest=hashlib.sha256(path.read_bytes()).hexdigest(),
        blur=blur_of(grey),
        brightness=float(np.log2(np.mean(middling) / 255.0)) if middling.size else 0.0,
        burnt=float(np.mean(grey >= _WHITE)),
        black=float(np.mean(grey <= _BLACK)),
        marker_ids=sorted({each for _, each, _ in find_markers(grey, dictionaries)}),
        corners=(corners - middle).astype(np.float32) / (focal * max(small.shape)),
        descriptors=descriptors,
        thumbnail=shrunk(color, THUMBNAIL_PX),
    )


def blur_of(grey: np.ndarray) -> float:
    """Return the blur of a picture (height, width) uint8, 0 to 1 (Crete et al., SPIE 6492, 2007).

    A sharp picture loses much of its grey value steps by one more blur, a blurred one little. Of
    the two directions the worse counts, for motion blur has one. Unlike the variance of the
    Laplacian it hardly depends on what the picture shows: photos of four sets that are sharp have
    0.11 to 0.25, with a motion of 5 px 0.27 to 0.43.
    """
    values = grey.astype(np.float32)
    worst = 0.0
    for axis, size in ((0, (1, _BLUR_REACH)), (1, (_BLUR_REACH, 1))):
        steps = np.abs(np.diff(values, axis=axis))
        blurred = np.abs(np.diff(cv2.blur(values, size), axis=axis))
        lost = np.maximum(steps - blurred, 0.0).sum(dtype=np.float64)
        worst = max(worst, 1.0 - lost / max(float(steps.sum(dtype=np.float64)), 1e-12))
    return worst


def _features(grey: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    small = shrunk(grey, FEATURE_PX)
    points, found = cv2.SIFT.create(nfeatures=N_FEATURES).detectAndCompute(small, None)
    if found is None:
        return small, np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    corners = np.array([point.pt for point in points]) + 0.5
    share = found / np.maximum(found.sum(axis=1, keepdims=True), 1e-12)
    return small, corners, np.sqrt(share).astype(np.float32)
