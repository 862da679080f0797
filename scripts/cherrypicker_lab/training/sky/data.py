"""Photos with sky masks: reading, splitting and cleaning the labels."""

from __future__ import annotations

import fnmatch
import logging
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.photos import list_photos, read_photo
from cherrypicker.sky.sizes import reduce_photo

logger = logging.getLogger(__name__)

MASK_SUFFIXES = (".png", ".tif", ".tiff", ".bmp")


@dataclass(frozen=True)
class SkyPhoto:
    """A photo with its sky mask."""

    name: str  # ``folder/file name``, the folder as `load_photos` was given it (its last part)
    source: str  # the folder; photos of one source are balanced against those of others
    image: np.ndarray  # ndarray of shape (H, W, 3), uint8, RGB
    sky: np.ndarray  # (H, W) bool
    certain: np.ndarray  # (H, W) bool: false where the label is doubtful, see `doubtful_pixels`


def _pairs(folder: Path) -> list[tuple[Path, Path]]:
    """Every photo of an ``images`` or ``photos`` folder at any depth, with its mask beside it."""
    pairs = []
    found = [*folder.rglob("images"), *folder.rglob("photos")]
    for images in sorted(p for p in found if p.is_dir()):
        for photo in list_photos(images):
            candidates = [images.parent / "masks" / f"{photo.stem}{s}" for s in MASK_SUFFIXES]
            mask = next((c for c in candidates if c.is_file()), None)
            if mask is None:
                raise StageError("photo without a sky mask", file=photo, key="train_sky.folders")
            pairs.append((photo, mask))
    return pairs


def doubtful_pixels(image: np.ndarray, sky: np.ndarray) -> np.ndarray:
    """Find pixels labelled not-sky that are probably sky seen through a crown, (H, W) bool.

    Hand-drawn masks outline a bare crown as one blob. Its gaps have the colour of the sky around
    them and are thin or small, unlike a white wall below the sky; training and label must not
    disagree there, so these pixels get no weight. The image is (H, W, 3) uint8, the sky (H, W)
    bool.
    """
    if not sky.any() or sky.all():
        return np.zeros(sky.shape, bool)
    side = max(sky.shape)
    sigma = 0.03 * side
    colors = image.astype(np.float32) / 255.0
    weight = cv2.GaussianBlur(sky.astype(np.float32), (0, 0), sigma)
    near = weight > 0.01
    local = cv2.GaussianBlur(colors * sky[..., None], (0, 0), sigma)
    local /= np.maximum(weight, 1e-3)[..., None]
    distance = np.linalg.norm(colors - local, axis=2)
    alike = (~sky) & near & (distance < 0.12)
    size = max(3, round(0.025 * side)) | 1
    large = cv2.morphologyEx(alike.astype(np.uint8), cv2.MORPH_OPEN, np.ones((size, size)))
    return alike & (large == 0)


def load_photos(folders: list[str], max_side: int) -> list[SkyPhoto]:
    """Read all photos and masks below some folders into memory, reduced in size.

    Each folder holds, at any depth, ``images/`` or ``photos/`` and ``masks/`` with equal stems (255
    = sky). Larger photos are reduced to `max_side` pixels on their longer side. Raises a
    `StageError` when a folder is missing or empty, or a mask is missing, unreadable or of another
    size.
    """
    photos = []
    for folder in map(Path, folders):
        if not folder.is_dir():
            raise StageError("training folder not found", file=folder, key="train_sky.folders")
        pairs = _pairs(folder)
        if not pairs:
            raise StageError(
                "no images/ and masks/ below the folder", file=folder, key="train_sky.folders"
            )
        for photo, mask_path in pairs:
            image = read_photo(photo)
            mask = cv2.imread(str(mask_path), cv2.IMREAD_GRAYSCALE)
            if mask is None or mask.shape != image.shape[:2]:
                raise StageError(
                    "mask unreadable or not of its photo's size",
                    file=mask_path,
                    key="train_sky.folders",
                )
            image, sky = reduce_photo(image, max_side), reduce_photo(mask, max_side) > 127
            name = f"{folder.name}/{photo.name}"
            certain = ~doubtful_pixels(image, sky)
            photos.append(SkyPhoto(name, folder.name, image, sky, certain))
        logger.info("%s: %d photos with sky masks", folder, len(pairs))
    return photos


def split_photos(
    photos: list[SkyPhoto], validation_fraction: float, holdout: list[str], seed: int
) -> tuple[list[SkyPhoto], list[SkyPhoto]]:
    """Split into training and validation photos.

    Frames of one drive show the same street again and again, so frames drawn at random would leak
    into the validation. With ``holdout`` patterns, exactly the photos whose name matches one are
    held out; without, one run of consecutive names per source (its place is seeded). Raises a
    `StageError` when either side is empty.
    """
    if holdout:
        held = {p.name for p in photos if any(fnmatch.fnmatch(p.name, h) for h in holdout)}
    else:
        rng = np.random.default_rng(seed)
        held = set()
        for source in sorted({p.source for p in photos}):
            names = sorted(p.name for p in photos if p.source == source)
            n_held = round(validation_fraction * len(names))
            start = int(rng.integers(0, len(names) - n_held + 1))
            held.update(names[start : start + n_held])
    training = [p for p in photos if p.name not in held]
    validation = [p for p in photos if p.name in held]
    if not training or not validation:
        raise StageError(
            f"{len(training)} photos for training and {len(validation)} for validation; "
            "both must have some",
            key="train_sky.holdout, train_sky.validation_fraction",
        )
    return training, validation
