"""Pixels and EXIF tags of a photo, whatever its container: plain, HEIF or camera raw.

Pixels are always in the sensor's grid, and the EXIF orientation says how the camera was held:
photos of one camera held both ways then share one calibration. HEIF decoders turn pixels upright
and raw converters too; that is undone or not done.
"""

import importlib
import io
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
from PIL import ExifTags, Image

from cherrypicker.errors import StageError
from cherrypicker.intake.kinds import Kind, kind_of
from cherrypicker.photos import (
    ORIENTATION,
    UNREADABLE,
    as_stored,
    exif_orientation,
    photo_error,
    read_photo,
    readable,
)

_KEPT = (ORIENTATION, ExifTags.Base.Make, ExifTags.Base.Model, ExifTags.Base.DateTime)
_KEPT_DETAILS = (
    *(ExifTags.Base.FocalLength, ExifTags.Base.FocalLengthIn35mmFilm),
    *(ExifTags.Base.DateTimeOriginal, ExifTags.Base.ExifImageWidth),
    *(ExifTags.Base.FocalPlaneXResolution, ExifTags.Base.FocalPlaneResolutionUnit),
)
# LibRaw's turns, counter-clockwise quarters by its own codes, as EXIF orientations
_ORIENTATION_OF_FLIP = {0: 1, 3: 3, 5: 8, 6: 6}


@dataclass(frozen=True)
class Still:
    """One photo."""

    pixels: np.ndarray  # (height, width, 3) uint8, RGB, the sensor's grid
    exif: Image.Exif  # with the orientation that brings them upright


def read_still(path: str | os.PathLike) -> Still:
    """Read a photo of any kind.

    Raises
    ------
    StageError
        If the file is missing or broken, or its kind needs a package that is not installed.
    """
    kind = kind_of(path)
    if kind is Kind.PLAIN:
        pixels = read_photo(path)
        exif = tags_of(path)
        exif[ORIENTATION] = exif_orientation(path)
        return Still(pixels, exif)
    if kind is Kind.HEIF:
        with _open_heif(path) as image:
            with readable(path):
                seen = np.asarray(image.convert("RGB"))
                exif = kept_tags(image.getexif())
            turned = int(image.info.get("original_orientation") or 1)
        exif[ORIENTATION] = turned if 1 <= turned <= 8 else 1
        return Still(np.ascontiguousarray(as_stored(seen, exif[ORIENTATION])), exif)
    with _open_raw(path) as raw:
        with readable(path, _needed("rawpy", path).LibRawError):
            flip = int(raw.sizes.flip)
            # As shot: white balance of the camera, no brightening from photo to photo
            pixels = raw.postprocess(use_camera_wb=True, no_auto_bright=True, user_flip=0)
        exif = _raw_exif(Path(path), raw)
    exif[ORIENTATION] = _ORIENTATION_OF_FLIP.get(flip, 1)
    return Still(pixels, exif)


def tags_of(path: str | os.PathLike) -> Image.Exif:
    """Return the EXIF tags of a photo from its header; none where it tells or shows none."""
    kind = kind_of(path)
    try:
        if kind is Kind.RAW:
            with _open_raw(path) as raw:
                return _raw_exif(Path(path), raw)
        with _open_heif(path) if kind is Kind.HEIF else Image.open(path) as image:
            return kept_tags(image.getexif())
    except (StageError, *UNREADABLE):
        return Image.Exif()


def still_size(path: str | os.PathLike) -> tuple[int, int]:
    """Return width and height of a HEIF or raw photo from its header, px, the sensor's grid.

    It raises as `read_still` does.
    """
    if kind_of(path) is Kind.HEIF:
        with _open_heif(path) as image:
            width, height = image.size
            turned = image.info.get("original_orientation") or 1
        return (height, width) if turned > 4 else (width, height)
    with _open_raw(path) as raw:
        return int(raw.sizes.width), int(raw.sizes.height)


def shrunk(pixels: np.ndarray, longer_px: int) -> np.ndarray:
    """Return a picture (height, width, ...) whose longer side has so many px at most."""
    shrink = longer_px / max(pixels.shape[:2])
    if shrink >= 1.0:
        return pixels
    return cv2.resize(pixels, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)


def _needed(name: str, path: str | os.PathLike) -> ModuleType:
    """Return an optional package, or say what is missing: plain photos do without."""
    try:
        return importlib.import_module(name.replace("-", "_"))
    except ImportError as error:
        raise photo_error(
            f"the photo needs the Python package {name}, which is not installed (pip install "
            f"{name}), or export it as JPEG",
            path,
        ) from error


def _open_heif(path: str | os.PathLike) -> Image.Image:
    """Open a HEIF photo: its pixels come upright, its orientation is in ``info``."""
    heif = _needed("pillow-heif", path)
    heif.register_heif_opener(thumbnails=False)
    with readable(path):
        return Image.open(path)


def _open_raw(path: str | os.PathLike):  # type: ignore[no-untyped-def]  # rawpy has no types
    package = _needed("rawpy", path)
    with readable(path, package.LibRawError):
        return package.imread(os.fspath(path))


def _raw_exif(path: Path, raw) -> Image.Exif:  # type: ignore[no-untyped-def]
    """EXIF tags of a raw photo: of the TIFF that most raws are, else of the JPEG inside."""
    with suppress(*UNREADABLE), open(path, "rb") as file:
        found = Image.Exif()
        found.load_from_fp(file)
        return kept_tags(found)
    with (
        suppress(_needed("rawpy", path).LibRawError, *UNREADABLE),
        Image.open(io.BytesIO(raw.extract_thumb().data)) as image,
    ):
        return kept_tags(image.getexif())
    return Image.Exif()


def kept_tags(exif: Image.Exif) -> Image.Exif:
    """Return the tags that hold for a photo in another container and size.

    Camera, lens, date and place; a size or a thumbnail would be another photo's, and a maker's own
    notes may be longer than a JPEG can hold: others stay, for what they say of gravity.
    The pixels across and the resolution in the focal plane only mean something together, the width
    of the sensor, and stay as they are.
    """
    kept = Image.Exif()
    for tag in _KEPT:
        if tag in exif:
            kept[tag] = exif[tag]
    details, place = exif.get_ifd(ExifTags.IFD.Exif), exif.get_ifd(ExifTags.IFD.GPSInfo)
    own, note = kept.get_ifd(ExifTags.IFD.Exif), details.get(ExifTags.Base.MakerNote)
    own.update({tag: details[tag] for tag in _KEPT_DETAILS if tag in details})
    kept.get_ifd(ExifTags.IFD.GPSInfo).update(place)
    if isinstance(note, bytes):
        own[ExifTags.Base.MakerNote] = note
        if _fit(kept):
            return kept
        del own[ExifTags.Base.MakerNote]
    return kept if _fit(kept) else Image.Exif()


def _fit(exif: Image.Exif) -> bool:
    """Whether a JPEG can hold these tags."""
    try:
        Image.new("L", (1, 1)).save(io.BytesIO(), format="JPEG", exif=exif)
    except UNREADABLE:  # broken, or too long
        return False
    return True
