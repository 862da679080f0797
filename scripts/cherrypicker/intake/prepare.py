"""The photos that every stage reads, from whatever lies in the tree's folder.

Plain photos are linked as they are; HEIF and raw photos, frames of videos and photos larger than
any stage uses become JPEG files with the tags that tell camera, place and orientation. A scan whose
photos are plain and small enough needs none of this.
"""

import logging
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.intake.kinds import Kind, kind_of, twins_in
from cherrypicker.intake.masks import MASKS_COLUMN, match_masks, read_user_mask, write_hidden
from cherrypicker.intake.stills import Still, read_still, shrunk, still_size
from cherrypicker.intake.video import STEP_KEY, choose_frames, film_header
from cherrypicker.photos import (
    JPEG_QUALITY,
    MIN_PHOTOS,
    ORIENTATION,
    UNREADABLE,
    check_promise,
    exif_orientation,
    photo_error,
    readable,
)
from cherrypicker.progress import in_threads

logger = logging.getLogger(__name__)

# Of an MP4's list of sizes (ISO/IEC 14496-12, stsz); an AVI's entry takes 16
LEAST_FRAME_BYTES = 4


@dataclass(frozen=True)
class PrepareOptions:
    """How photos are prepared; the fields are config keys of ``photos`` and ``sfm``."""

    max_size_px: int = 6000
    video_step: float = 0.05
    skip_unreadable: bool = False


def size_of_capture(path: str | os.PathLike) -> tuple[int, int, float]:
    """Return width and height of a photo or film from its header, and its seconds, 0 for a photo.

    Raises
    ------
    StageError
        If it cannot be read, or its sizes make no sense.
    """
    kind = kind_of(path)
    with readable(path):
        if kind is Kind.VIDEO:
            film = film_header(path)
            # A header may promise anything; a frame takes its entry in the list at least
            n_frames = min(film.n_frames, os.path.getsize(path) // LEAST_FRAME_BYTES)
            return film.width, film.height, n_frames / max(film.per_second or 30.0, 1.0)
        if kind in (Kind.HEIF, Kind.RAW):
            return *still_size(path), 0.0
        with Image.open(path) as image:
            check_promise(image, path)
            return *image.size, 0.0


def prepare_photos(
    captures: Sequence[str | os.PathLike],
    folder: str | os.PathLike,
    mask_folder: str | os.PathLike,
    options: PrepareOptions,
    *,
    user_masks: str | os.PathLike = "",
    threads: int = 1,
) -> dict:
    """Prepare the photos of one scan, from photos and videos of one folder.

    So many ``threads`` work at a time. ``folder`` takes the prepared photos, named as they came but
    for the suffix, frames with their number. ``mask_folder`` takes a mask for each where a folder
    of ``user_masks`` is given, and stays empty otherwise.

    Returns ``photos``: of each prepared one its ``source``, size, EXIF orientation, whether it is
    the file as it came, and the share that is ``hidden``; ``left_out``: why each other one is not
    there; ``without_mask``.

    Raises
    ------
    StageError
        If a file cannot be read (unless ``skip_unreadable``), a film is too short or too still, or
        a mask does not fit.
    """
    paths = sorted(map(Path, captures))
    folder, mask_folder = Path(folder), Path(mask_folder)
    for place in (folder, mask_folder):
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
    left_out = {
        name: f"the same photo as {other}" for name, other in twins_in(paths[0].parent).items()
    }
    done: dict[str, dict] = {}

    def work(path: Path) -> dict[str, dict] | str:
        try:
            return _prepare(path, folder, options)
        except _StillFilmError as error:
            if len(paths) == 1:
                raise
            return error.cause  # a clip by the way beside photos
        except StageError as error:
            if not options.skip_unreadable:
                raise
            return error.cause

    for path, made in zip(paths, in_threads(work, paths, threads, "photos prepared"), strict=True):
        if isinstance(made, str):
            left_out[path.name] = made
            continue
        for name in made.keys() & done.keys():
            cause = f"{path.name} and {done[name]['source']} would both become {name}; rename one"
            raise photo_error(cause, path)
        done |= made
    for name, reason in left_out.items():
        logger.warning("%s is left out: %s", name, reason)
    without = []
    if user_masks:
        if Path(user_masks).resolve() == paths[0].parent.resolve():
            cause = "the masks lie among the photos; give them a folder of their own"
            raise StageError(cause, file=user_masks, key=MASKS_COLUMN)
        without = _apply_masks(user_masks, done, list(left_out), mask_folder)
    n_linked = sum(entry["is_as_it_came"] for entry in done.values())
    logger.info("%d photos, %d of them as they came", len(done), n_linked)
    return {"photos": done, "left_out": left_out, "without_mask": without}


class _StillFilmError(StageError):
    """A film in which the picture hardly moves."""


def _prepare(path: Path, folder: Path, options: PrepareOptions) -> dict[str, dict]:
    """Prepare one file; return what its photos are, by their names."""
    if kind_of(path) is Kind.VIDEO:
        return _prepare_film(path, folder, options)
    if kind_of(path) is Kind.PLAIN:
        try:
            with Image.open(path) as image:
                width, height = image.size
        except UNREADABLE:  # what is no photo is for the next stage to refuse
            width = height = 0
        if not is_too_large((width, height), options.max_size_px):
            try:
                os.link(path.resolve(), folder / path.name)
            except OSError:  # another disk, or one without links
                shutil.copyfile(path, folder / path.name)
            orientation = exif_orientation(path)
            return {path.name: _entry(path, (height, width), (width, height), orientation, True)}
    still, name = read_still(path), path.with_suffix(".jpg").name
    size = write_still(folder / name, still, options.max_size_px)
    return {name: _entry(path, still.pixels.shape, size, still.exif[ORIENTATION], False)}


def _prepare_film(path: Path, folder: Path, options: PrepareOptions) -> dict[str, dict]:
    header = film_header(path)
    exif = Image.Exif()
    exif[ORIENTATION] = header.orientation
    # Films are cropped and scaled otherwise than photos: no photo shares their calibration
    exif[ExifTags.Base.Model] = "video"
    made: dict[str, dict] = {}
    for frame in choose_frames(path, options.video_step):
        name = f"{path.stem}_{frame.number:06d}.jpg"
        still = Still(frame.pixels, exif)
        size = write_still(folder / name, still, options.max_size_px)
        entry = _entry(path, still.pixels.shape, size, header.orientation, False)
        made[name] = entry | {"frame": frame.number}
    if len(made) < MIN_PHOTOS:
        for name in made:
            (folder / name).unlink()
        raise _StillFilmError(
            f"the video of {header.n_frames} frames gives {len(made)} photos, since the picture "
            f"hardly moves in it; at least {MIN_PHOTOS} are needed",
            file=path,
            key=STEP_KEY,
        )
    logger.info("%s: %d of %d frames are taken", path.name, len(made), header.n_frames)
    return made


def _entry(
    path: Path, came: tuple[int, ...], size: tuple[int, int], orientation: int, as_it_came: bool
) -> dict:
    """What is told of a photo that came with a shape (height, width, ...)."""
    return {
        "source": path.name,
        "width": size[0],
        "height": size[1],
        "source_width": came[1],
        "source_height": came[0],
        "exif_orientation": int(orientation),
        "is_as_it_came": as_it_came,
    }


def is_too_large(size: tuple[int, int], max_size_px: int) -> bool:
    """Whether a photo of a size (width, height) is larger than it is used."""
    return 0 < max_size_px < max(size)


def write_still(path: Path, still: Still, max_size_px: int) -> tuple[int, int]:
    """Write a photo as JPEG, reduced where it is too large; return its width and height."""
    pixels = shrunk(still.pixels, max_size_px) if max_size_px else still.pixels
    with atomic_path(path) as temporary:
        Image.fromarray(np.ascontiguousarray(pixels)).save(
            temporary, format="JPEG", quality=JPEG_QUALITY, subsampling=0, exif=still.exif
        )
    return pixels.shape[1], pixels.shape[0]


def _apply_masks(
    user_masks: str | os.PathLike, done: dict[str, dict], left_out: list[str], mask_folder: Path
) -> list[str]:
    """Write the mask of every photo, enter its hidden share; return the photos that have none."""
    # A mask bears the name of the photo's file, that of a frame the name of the frame
    names = {name if "frame" in entry else entry["source"]: name for name, entry in done.items()}
    masks = match_masks(user_masks, list(names), left_out)
    for own, name in names.items():
        entry = done[name]
        if not entry["width"]:  # no photo, which the next stage tells
            continue
        came = (entry["source_height"], entry["source_width"])
        hidden = np.zeros(came, bool)
        if own in masks:
            hidden = read_user_mask(masks[own], own, came, entry["exif_orientation"])
        write_hidden(mask_folder / f"{name}.png", hidden, (entry["width"], entry["height"]))
        entry["hidden"] = round(float(hidden.mean()), 4)
    without = sorted(name for name in names if name not in masks)
    if without:
        logger.warning(
            "%d of %d photos have no mask and are used whole: %s",
            *(len(without), len(done), ", ".join(without[:4])),
        )
    return without
