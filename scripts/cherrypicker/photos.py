"""Photos on disk, in the pixel grid that COLMAP reads."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from cherrypicker.errors import StageError

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
_ORIENTATION = 0x0112


def photos_in(folder: str | os.PathLike) -> list[Path]:
    """Return a folder's photos, sorted by name, hidden ones left out; none if it is missing."""
    folder = Path(folder)
    if not folder.is_dir():
        return []
    return sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in PHOTO_SUFFIXES and not path.name.startswith(".")
    )


def list_photos(folder: str | os.PathLike) -> list[Path]:
    """Return the photos of a folder, sorted by name; hidden files are left out.

    Raises
    ------
    StageError
        If the folder is missing or holds no photo.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise StageError("the folder of photos is missing", file=folder, key="photos in trees.tsv")
    photos = photos_in(folder)
    if not photos:
        raise StageError(
            f"the folder holds no photo ({', '.join(PHOTO_SUFFIXES)})",
            file=folder,
            key="photos in trees.tsv",
        )
    return photos


def read_photo(path: str | os.PathLike) -> np.ndarray:
    """Read a photo as COLMAP does: (height, width, 3) uint8, RGB, the EXIF orientation not applied.

    Raises
    ------
    StageError
        If the file is missing, truncated or no image.
    """
    try:
        with Image.open(path) as image:
            if image.format == "TIFF":  # Pillow would turn its pixels on loading
                image.getexif().pop(_ORIENTATION, None)
            if image.mode in ("I;16", "I;16B", "I;16L", "I"):
                grey = np.asarray(image).astype(np.float64) / 257.0
                return np.repeat(
                    np.clip(np.rint(grey), 0, 255).astype(np.uint8)[..., None], 3, axis=2
                )
            return np.asarray(image.convert("RGB"))
    except FileNotFoundError as error:
        raise StageError("the photo is missing", file=path, key="photos in trees.tsv") from error
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError) as error:
        raise StageError(
            f"the photo cannot be read ({error})", file=path, key="photos in trees.tsv"
        ) from error


def exif_orientation(path: str | os.PathLike) -> int:
    """Return the EXIF orientation, 1 (upright) to 8; 1 where none is given."""
    try:
        with Image.open(path) as image:
            orientation = int(image.getexif().get(_ORIENTATION, 1))
    except (OSError, UnidentifiedImageError, ValueError, TypeError):
        return 1
    return orientation if 1 <= orientation <= 8 else 1
