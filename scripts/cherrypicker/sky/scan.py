"""Masks and sky colours of all photos of one scan."""

import logging
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.intake.masks import read_hidden
from cherrypicker.photos import exif_orientation, list_photos, photo_error, read_photo
from cherrypicker.progress import Progress
from cherrypicker.sky.colors import N_SAMPLES, sample_sky_pixels
from cherrypicker.sky.mask_files import HIDDEN, write_mask
from cherrypicker.sky.masks import MaskOptions, sky_mask
from cherrypicker.sky.unet import SkyUNet

logger = logging.getLogger(__name__)


def photos_by_stem(folder: Path) -> dict[str, Path]:
    """List a folder's photos by stem, which names their mask.

    Raises
    ------
    StageError
        When two photos share a stem (case counts not, since not every file system tells it).
    """
    photos = list_photos(folder)
    counts = Counter(p.stem.lower() for p in photos)
    twins = [p.name for p in photos if counts[p.stem.lower()] > 1]
    if twins:
        raise photo_error(
            f"photos share a name but for the suffix: {', '.join(twins[:4])}; rename one", folder
        )
    return {p.stem: p for p in photos}


def mask_photos(
    net: SkyUNet,
    folder: Path,
    mask_folder: Path,
    options: MaskOptions,
    *,
    n_samples: int = N_SAMPLES,
    seed: int,
    photo_masks: Path | None = None,
) -> np.ndarray:
    """Write one mask per photo of a folder, ``{stem}.png``, and sample the colours of the sky.

    The network is in evaluation mode. Over all photos at most ``n_samples`` sky pixels are sampled,
    of each at most its share. What a user's prepared masks in the folder ``photo_masks`` hide is
    neither sky nor anything else. Returns the colours, (n, 3) uint8, in the order of the photos'
    names.

    Raises
    ------
    StageError
        When the folder is missing or empty, two photos share a stem, or none can be read. One
        that cannot is passed over: whether the scan goes on without it, its features decide.
    """
    paths = list(photos_by_stem(folder).values())
    share = -(-n_samples // len(paths))
    seeds = np.random.SeedSequence(seed).spawn(len(paths))
    mask_folder.mkdir(parents=True, exist_ok=True)
    samples, fractions = [], []
    problem: StageError | None = None

    def load(path: Path) -> tuple[np.ndarray, int] | StageError:
        try:
            return read_photo(path), exif_orientation(path)
        except StageError as error:
            return error

    with ThreadPoolExecutor(1) as reader, Progress(len(paths), "sky masks") as bar:
        pending = reader.submit(load, paths[0])
        for index, path in enumerate(paths):
            loaded = pending.result()
            if index + 1 < len(paths):  # decode the next photo while this one is worked on
                pending = reader.submit(load, paths[index + 1])
            if isinstance(loaded, StageError):
                logger.warning("%s has no mask: %s", path.name, loaded.cause)
                problem = problem or loaded
                bar.step()
                continue
            image, orientation = loaded
            mask = sky_mask(net, image, options, orientation)
            mask[read_hidden(photo_masks, path.name, mask.shape)] = HIDDEN
            write_mask(mask_folder / f"{path.stem}.png", mask)
            rng = np.random.default_rng(seeds[index])
            is_sky = np.where(mask == 255, mask, 0)
            samples.append(sample_sky_pixels(image, is_sky, share, rng))
            fractions.append(float(np.count_nonzero(is_sky)) / mask.size)
            logger.info("%s: %.1f %% sky", path.name, 100 * fractions[-1])
            bar.step()
    if not samples:
        raise problem or StageError("no photo can be read", file=folder)
    logger.info(
        "sky in %d of %d photos, %.1f %% of the pixels on average",
        *(sum(f > 0.001 for f in fractions), len(fractions), 100 * float(np.mean(fractions))),
    )
    return np.concatenate(samples)
