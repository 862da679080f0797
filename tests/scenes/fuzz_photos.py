"""Readers of photos, masks and films, with valid files to spoil."""

import cv2
import numpy as np
from dng_file import write_dng
from fuzz_bench import Reader
from PIL import Image

from cherrypicker.batch.scans import sizes_of
from cherrypicker.capture.look import look_at
from cherrypicker.command.init import date_of
from cherrypicker.intake.gravity import stated_up
from cherrypicker.intake.masks import match_masks, read_hidden, read_user_mask
from cherrypicker.intake.places import stated_place
from cherrypicker.intake.prepare import PrepareOptions, prepare_photos
from cherrypicker.intake.stills import read_still
from cherrypicker.intake.video import choose_frames, film_header
from cherrypicker.photos import exif_camera, exif_orientation
from cherrypicker.sky.mask_files import read_masks, write_mask

WIDTH, HEIGHT = 48, 32


def _picture():
    image = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    image[: HEIGHT // 2] = (90, 140, 220)
    return image


def _tags():
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0112] = "Orchard", "Phone", 6
    exif.get_ifd(0x8769).update({0x920A: 5.0, 0xA405: 26, 0x9003: "2026:03:01 10:00:00"})
    exif.get_ifd(0x8825).update(
        {1: "N", 2: (48.0, 30.0, 1.5), 3: "E", 4: (9.0, 3.0, 2.5), 5: b"\0", 6: 320.5}
    )
    return exif.tobytes()


def _plain(folder):
    image = Image.fromarray(_picture())
    image.save(folder / "a.jpg", exif=_tags(), quality=90)
    image.save(folder / "b.jpg", exif=_tags(), progressive=True)
    image.save(folder / "c.png", exif=_tags())
    image.save(folder / "d.tif", compression="tiff_lzw")
    image.save(folder / "f.tif", exif=_tags())
    Image.fromarray(_picture()[..., 0].astype(np.uint16) * 250).save(folder / "e.png")
    return sorted(folder.iterdir())


def _heic(folder):
    import pillow_heif

    pillow_heif.register_heif_opener()
    Image.fromarray(_picture()).save(folder / "a.heic", exif=_tags())
    return [folder / "a.heic"]


def _raws(folder):
    write_dng(folder / "a.dng", _picture())
    return [folder / "a.dng"]


def _films(folder):
    for name, code in (("a.mp4", "mp4v"), ("b.avi", "MJPG")):
        film = cv2.VideoWriter(str(folder / name), cv2.VideoWriter_fourcc(*code), 10, (64, 48))
        wall = np.random.default_rng(0).integers(0, 255, (48, 128, 3), dtype=np.uint8)
        for i in range(12):
            film.write(np.ascontiguousarray(wall[:, 4 * i : 4 * i + 64]))
        film.release()
    return sorted(folder.iterdir())


def _masks(folder):
    Image.fromarray(np.full((HEIGHT, WIDTH), 255, np.uint8)).save(folder / "a.jpg.png")
    return [folder / "a.jpg.png"]


def _sky_masks(folder):
    write_mask(folder / "a.png", np.full((HEIGHT, WIDTH), 255, np.uint8))
    return [folder / "a.png"]


def _any(folder):
    return _plain(folder) + _heic(folder) + _raws(folder) + _films(folder)


def still_with_tags(path):
    """Pixels, turn, camera, place and date of a photo of any kind."""
    stated_place(path), stated_up(path), date_of(path), exif_orientation(path), exif_camera(path)
    return read_still(path)


def frames_of(path):
    film_header(path)
    return sum(1 for _ in choose_frames(path, 0.05))


def size_at_the_start(path):
    """What Snakemake's own process reads of a photo or film: it must never stop the batch."""
    return sizes_of([path])


def prepared(path):
    """One file beside good ones, which are left as they are."""
    folder, options = path.with_name("out"), PrepareOptions(max_size_px=40)
    return prepare_photos([path], folder / "photos", folder / "masks", options)


def looked_at(path):
    """A photo as the check in the field sees it."""
    return list(look_at([path], {}, 1))


def mask_of_user(path):
    mask = match_masks(path.parent, ["a.jpg"])["a.jpg"]
    return read_user_mask(mask, "a.jpg", (HEIGHT, WIDTH), 1)


def mask_prepared(path):
    return read_hidden(path.parent, "a.jpg", (HEIGHT, WIDTH))


def mask_of_sky(path):
    return read_masks(path, (HEIGHT, WIDTH))


# Deflate packs a picture of one bit by 1032 to 1 (https://zlib.net); five bytes stand for each
# pixel while it becomes RGB
OF_PICTURES = 8 * 1032 * 6

READERS = [
    Reader("photo", still_with_tags, _plain, OF_PICTURES),
    Reader("heic", still_with_tags, _heic, OF_PICTURES, needs="pillow_heif"),
    Reader("raw", still_with_tags, _raws, needs="rawpy"),
    Reader("film", frames_of, _films),
    Reader("photo_at_the_start", size_at_the_start, _any, needs="pillow_heif"),
    Reader("prepared", prepared, _any, OF_PICTURES, needs="pillow_heif"),
    Reader("look", looked_at, _any, OF_PICTURES, needs="pillow_heif"),
    Reader("mask", mask_of_user, _masks, OF_PICTURES),
    Reader("prepared_mask", mask_prepared, _masks, OF_PICTURES),
    Reader("sky_mask", mask_of_sky, _sky_masks, OF_PICTURES),
]
