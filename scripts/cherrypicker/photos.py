"""Photos on disk, in the pixel grid that COLMAP reads: the sensor's, whatever way it was held."""

import os
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image

from cherrypicker.errors import StageError
from cherrypicker.files import files_with

PHOTOS_COLUMN = "photos in trees.tsv"
# Two photos give no scale to what a third sees, and a film of so few frames shows no walk
MIN_PHOTOS = 3
# COLMAP's default recompresses at a quality that blurs twigs (guess)
JPEG_QUALITY = 96
# Pillow refuses twice its own limit, 179 megapixels, as an attack; phones make 200
Image.MAX_IMAGE_PIXELS = 500_000_000
PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
ORIENTATION = ExifTags.Base.Orientation
# Longest focal length that is taken for one, mm
LONGEST_FOCAL_MM = 1e4
# Pixels that a byte of a file can hold at most, as deflate packs them (https://zlib.net: 1032 to 1)
MOST_BYTES_A_BYTE = 1032
# What Pillow raises of broken files, their tags included
UNREADABLE = (
    *(OSError, EOFError, SyntaxError, ValueError, TypeError, LookupError, ArithmeticError),
    *(AttributeError, RuntimeError, struct.error, Image.DecompressionBombError),
)

# EXIF orientation -> what brings the stored pixels upright: (mirror left-right first, quarter turns
# counter-clockwise as np.rot90 counts).
UPRIGHT = {
    1: (False, 0),
    2: (True, 0),
    3: (False, 2),
    4: (True, 2),
    5: (True, 1),
    6: (False, 3),
    7: (True, 3),
    8: (False, 1),
}


def photo_error(cause: str, file: str | os.PathLike | None = None) -> StageError:
    """Return the error of a tree whose photos are to be changed."""
    return StageError(cause, file=file, key=PHOTOS_COLUMN)


def photos_in(folder: str | os.PathLike) -> list[Path]:
    """Return a folder's photos, sorted by name, hidden ones left out; none if it is missing."""
    return files_with(folder, PHOTO_SUFFIXES)


def list_photos(
    folder: str | os.PathLike,
    find: Callable[[Path], list[Path]] = photos_in,
    wanted: str = f"no photo ({', '.join(PHOTO_SUFFIXES)})",
) -> list[Path]:
    """Return the photos of a folder, or what else `find` finds there.

    Raises
    ------
    StageError
        If the folder is missing, or holds nothing that is `wanted`.
    """
    folder = Path(folder)
    found = find(folder)
    if not found:
        cause = (
            f"the folder holds {wanted}" if folder.is_dir() else "the folder of photos is missing"
        )
        raise photo_error(cause, folder)
    return found


def photo_files(paths: Sequence[str | os.PathLike]) -> list[Path]:
    """Return photo files as paths; a folder stands for the photos in it.

    Raises
    ------
    StageError
        If a folder holds no photo.
    """
    found: list[Path] = []
    for path in map(Path, paths):
        found += list_photos(path) if path.is_dir() else [path]
    return found


def check_promise(image: Image.Image, path: str | os.PathLike, key: str = PHOTOS_COLUMN) -> None:
    """Refuse an opened picture whose header promises more pixels than its file can hold.

    Raises
    ------
    StageError
        Before any of its pixels is read.
    """
    held_bits = 8 * os.path.getsize(path) * MOST_BYTES_A_BYTE
    bits = {"1": 1, "I": 16, "F": 32}.get(image.mode, 8) * len(image.getbands())
    width, height = image.size
    if width * height * bits > held_bits:
        raise StageError(
            f"the header promises {width:,} x {height:,} pixels, for which the file is too short",
            file=path,
            key=key,
        )


def read_photo(path: str | os.PathLike) -> np.ndarray:
    """Read a photo as COLMAP does: (height, width, 3) uint8, RGB, the EXIF orientation not applied.

    Raises
    ------
    StageError
        If the file is missing, truncated or no image.
    """
    with readable(path), Image.open(path) as image:
        check_promise(image, path)
        if image.format == "TIFF":  # Pillow would turn its pixels on loading
            image.getexif().pop(ORIENTATION, None)
        if image.mode in ("I;16", "I;16B", "I;16L", "I"):
            grey = np.asarray(image).astype(np.float64) / 257.0
            return np.repeat(np.clip(np.rint(grey), 0, 255).astype(np.uint8)[..., None], 3, axis=2)
        return np.asarray(image.convert("RGB"))


@contextmanager
def readable(path: str | os.PathLike, *more: type[Exception]) -> Iterator[None]:
    """Raise what Pillow, or `more`, says of a broken photo as a StageError."""
    broken: tuple[type[Exception], ...] = (*UNREADABLE, *more)
    try:
        yield
    except FileNotFoundError as error:
        raise photo_error("the photo is missing", path) from error
    except broken as error:
        raise photo_error(f"the photo cannot be read ({error})", path) from error


def exif_orientation(path: str | os.PathLike) -> int:
    """Return the EXIF orientation, 1 (upright) to 8; 1 where none is given."""
    try:
        with Image.open(path) as image:
            orientation = int(image.getexif().get(ORIENTATION, 1))
    except UNREADABLE:
        return 1
    return orientation if 1 <= orientation <= 8 else 1


def exif_camera(path: str | os.PathLike) -> tuple[str, float]:
    """Return camera name and focal length in mm; broken EXIF data count as none."""
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            details = exif.get_ifd(ExifTags.IFD.Exif)
            tags = ExifTags.Base.Make, ExifTags.Base.Model
            words = [str(exif.get(tag, "")).strip("\0 ") for tag in tags]
            focal = float(details.get(ExifTags.Base.FocalLength) or 0.0)
    except UNREADABLE:
        return "", 0.0
    focal = focal if 0.0 < focal < LONGEST_FOCAL_MM else 0.0
    return " ".join(word for word in words if word), focal


def upright(image: np.ndarray, orientation: int) -> np.ndarray:
    """Turn stored pixels upright, as EXIF orientation 1 to 8 says."""
    mirror, turns = UPRIGHT[orientation]
    return np.rot90(image[:, ::-1] if mirror else image, turns)


def as_stored(image: np.ndarray, orientation: int) -> np.ndarray:
    """Undo `upright`."""
    mirror, turns = UPRIGHT[orientation]
    image = np.rot90(image, -turns)
    return image[:, ::-1] if mirror else image


def linear_light(grey: np.ndarray) -> np.ndarray:
    """Light of grey values, 0 to 255, as a share of white's (sRGB, IEC 61966-2-1): it adds up."""
    share = grey / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
