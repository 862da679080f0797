"""Look at each photo before COLMAP does: readable, how large, taken with which camera."""

import hashlib
import logging
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cherrypicker.errors import StageError
from cherrypicker.photos import (
    MIN_PHOTOS,
    PHOTOS_COLUMN,
    exif_camera,
    exif_orientation,
    photo_error,
    read_photo,
)
from cherrypicker.progress import in_threads

logger = logging.getLogger(__name__)

# Photos from this size on are searched for features without enlarging them first. The largest are
# kept, so where there are enough without it, what the enlarged photo shows would be thrown away: on
# 12 megapixels, searched at 4.3, that was two thirds of the time.
PLAIN_FIRST_MP = 2.0


def megapixels(width: int, height: int, limit_px: float) -> float:
    """Megapixels of a photo once its longer side is at most ``limit_px``; 0 leaves it as it is."""
    shrink = min(1.0, (limit_px or math.inf) / max(width, height, 1))
    return width * height * shrink**2 / 1e6


@dataclass(frozen=True)
class PhotoInfo:
    """One photo of the folder."""

    path: Path
    # width, height: stored size, px (EXIF orientation not applied); 0 where unreadable
    width: int = 0
    height: int = 0
    camera: str = ""  # maker and model by EXIF, empty where not given
    focal_mm: float = 0.0  # focal length by EXIF, 0 where not given
    orientation: int = 1  # EXIF orientation, 1 to 8. Pixels are used as stored.
    problem: str = ""  # why the photo is left out, empty for a good one
    digest: str = ""  # hash of the file, to find copies; empty for one that is no photo

    @property
    def name(self) -> str:
        return self.path.name


def check_photos(
    photos: Sequence[str | os.PathLike],
    *,
    folder: str | os.PathLike = "",
    skip_unreadable: bool = False,
    threads: int = 1,
) -> list[PhotoInfo]:
    """Decode every photo of a folder and read its EXIF tags, sorted by name.

    COLMAP itself accepts a truncated JPEG and fills the rest with grey, so it is no judge. Photos
    left out have a ``problem``: copies, and with ``skip_unreadable`` what is unreadable.

    A `StageError`, of ``folder`` or of the photo at fault, where there is no photo, one is
    unreadable, photos lie in several folders, or fewer than three usable ones are left.
    """
    paths = sorted((Path(photo) for photo in photos), key=lambda path: path.name)
    if not paths:
        raise photo_error(
            "no photo found in the folder (.jpg, .jpeg, .png, .tif, .tiff)", folder or None
        )
    if len({path.parent for path in paths}) > 1:
        raise photo_error("the photos lie in several folders", paths[0])
    infos = list(in_threads(_check_photo, paths, threads, "photos checked"))
    unreadable = [info for info in infos if info.problem]
    if unreadable and not skip_unreadable:
        more = f" (and {len(unreadable) - 1} more)" if len(unreadable) > 1 else ""
        raise StageError(
            f"the photo {unreadable[0].name}{more} is {unreadable[0].problem}",
            file=unreadable[0].path,
            key=f"{PHOTOS_COLUMN} or sfm.skip_unreadable",
        )
    # A copy adds nothing but a zero baseline.
    same = copies(infos)
    infos = [
        replace(info, problem=f"a copy of {same[info.name]}") if info.name in same else info
        for info in infos
    ]
    for info in infos:
        if info.problem:
            logger.warning("%s is left out: %s", info.name, info.problem)
    n_usable = sum(not info.problem for info in infos)
    if n_usable < MIN_PHOTOS:
        raise photo_error(
            f"{n_usable} usable photo(s) of {len(infos)}, at least {MIN_PHOTOS} are needed",
            folder or paths[0].parent,
        )
    return infos


def group_by_camera(infos: Sequence[PhotoInfo], camera_mode: str) -> list[list[PhotoInfo]]:
    """Group usable photos that share one camera calibration.

    Photos share a camera only if stored size, EXIF model and EXIF focal length are the same. The
    EXIF orientation does not matter: the stored pixels are the sensor's either way. The mode
    ``auto`` shares a camera only where EXIF names it, ``per_image`` none, ``folder`` all that can
    be. Groups are in order of their first photos.
    """
    groups: dict[tuple, list[PhotoInfo]] = {}
    for info in infos:
        if info.problem:
            continue
        key: tuple = (info.width, info.height, info.camera, round(info.focal_mm, 2))
        if camera_mode == "per_image" or (camera_mode == "auto" and not info.camera):
            key = (*key, info.name)
        groups.setdefault(key, []).append(info)
    return list(groups.values())


def _check_photo(path: Path) -> PhotoInfo:
    try:
        height, width = read_photo(path).shape[:2]
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        camera, focal_mm = exif_camera(path)
    except StageError as error:
        return PhotoInfo(path, problem=f"unreadable: {error.cause}")
    return PhotoInfo(path, width, height, camera, focal_mm, exif_orientation(path), digest=digest)


def copies(infos: Iterable[PhotoInfo]) -> dict[str, str]:
    """Return the names of byte-equal photos with that of the first of them."""
    first: dict[str, str] = {}
    originals = {one.name: first.setdefault(one.digest, one.name) for one in infos if one.digest}
    return {name: original for name, original in originals.items() if original != name}
