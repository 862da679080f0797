"""A user's own masks beside the photos: what they paint black is not to be looked at.

A mask belongs to the photo of its name, ``IMG_1.png`` or, as COLMAP has it, ``IMG_1.jpg.png``. It
is laid over the photo as one sees it, each turned upright by its own EXIF orientation.
"""

import os
from collections.abc import Collection
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path, files_with
from cherrypicker.photos import UNREADABLE, as_stored, check_promise, exif_orientation, upright

MASKS_COLUMN = "masks in trees.tsv"


def match_masks(
    folder: str | os.PathLike, photos: Collection[str], left_out: Collection[str] = ()
) -> dict[str, Path]:
    """Return the user's masks by the file names of the photos that they belong to.

    Masks of photos that are `left_out`, not used, are passed over.

    Raises
    ------
    StageError
        If the folder is missing or empty, or a mask belongs to no photo or to one that has another.
    """
    masks = files_with(folder, (".png",))
    if not masks:
        cause = "the folder holds no mask (.png)"
        if not Path(folder).is_dir():
            cause = "the folder of masks is missing"
        raise StageError(cause, file=folder, key=MASKS_COLUMN)
    by_name = {name: name for name in photos} | {Path(name).stem: name for name in photos}
    unused = {*left_out, *(Path(name).stem for name in left_out)}
    found: dict[str, Path] = {}
    for mask in masks:
        photo = by_name.get(mask.stem, "")
        if not photo and mask.stem in unused:
            continue
        cause = "the mask belongs to no photo: its name is that of the photo with .png"
        if photo in found:
            cause = f"{photo} has two masks, {found[photo].name} the other"
        if not photo or photo in found:
            raise StageError(cause, file=mask, key=MASKS_COLUMN)
        found[photo] = mask
    return found


def read_user_mask(path: Path, photo: str, shape: tuple[int, int], orientation: int) -> np.ndarray:
    """Return what a user's mask hides of a photo, bool, in its stored pixels.

    The photo's `shape` is (height, width) as it came, stored, its `orientation` EXIF's.

    Raises
    ------
    StageError
        If the mask cannot be read or has another size than the photo.
    """
    try:
        stored = _grey(path)
    except UNREADABLE as error:
        raise StageError(
            f"the mask cannot be read ({error})", file=path, key=MASKS_COLUMN
        ) from error
    mask = upright(stored, exif_orientation(path))
    wanted = shape if orientation <= 4 else shape[::-1]
    if mask.shape != wanted:
        raise StageError(
            f"the mask has {mask.shape[1]} x {mask.shape[0]} pixels, {photo} as one sees it "
            f"{wanted[1]} x {wanted[0]}",
            file=path,
            key=MASKS_COLUMN,
        )
    return as_stored(mask, orientation) == 0


def write_hidden(path: str | os.PathLike, hidden: np.ndarray, size: tuple[int, int]) -> None:
    """Write what is hidden (height, width) bool as COLMAP has it, black, at a size (w, h)."""
    seen = np.where(hidden, 0, 255).astype(np.uint8)
    if seen.shape != size[::-1]:
        seen = cv2.resize(seen, size, interpolation=cv2.INTER_NEAREST).astype(np.uint8)
    with atomic_path(path) as temporary:
        Image.fromarray(seen).save(temporary, format="PNG")


def read_grey(
    path: str | os.PathLike, what: str, shape: tuple[int, int] | None = None, key: str | None = None
) -> np.ndarray:
    """Read a picture of ours, such as a mask, as (height, width) uint8.

    By Pillow: OpenCV takes the memory that a chunk of a PNG promises, up to 4 GB.

    Raises
    ------
    StageError
        If it is missing, unreadable or not of the expected shape (height, width).
    """
    try:
        picture = _grey(path)
    except (StageError, *UNREADABLE) as error:
        raise StageError(f"{what} is missing or unreadable", file=path, key=key) from error
    if shape is not None and picture.shape != tuple(shape):
        sizes = f"{picture.shape[1]} x {picture.shape[0]} pixels, its photo {shape[1]} x {shape[0]}"
        raise StageError(f"{what} has {sizes}", file=path, key=key)
    return picture


def _grey(path: str | os.PathLike) -> np.ndarray:
    with Image.open(path) as image:
        check_promise(image, path, MASKS_COLUMN)
        return np.asarray(image.convert("L"))


def read_hidden(folder: str | os.PathLike | None, photo: str, shape: tuple[int, int]) -> np.ndarray:
    """Return what is hidden of a prepared photo, (height, width) bool; nothing without a folder.

    It raises as `read_grey` does.
    """
    if folder is None:
        return np.zeros(shape, bool)
    path = Path(folder) / f"{photo}.png"
    return read_grey(path, "the prepared mask", shape, MASKS_COLUMN) == 0
