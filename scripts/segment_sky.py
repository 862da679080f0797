"""Tell sky from everything else in every photo, and find the sky's dominant colours.

Reads the folder of photos and the sky network's weights, writes one mask per photo
(``{stem}.png``, 255 = sky, in the pixels of the photo as COLMAP reads it) and
``sky_colors.npz``. Example:

    python scripts/segment_sky.py --photo_folder photos/tree_1 --masks results/tree_1/sky \\
        --colors results/tree_1/sky_colors.npz
"""

import logging
from pathlib import Path
from typing import Annotated

import cv2
import torch

from cherrypicker.runner import run, stage_parser
from cherrypicker.sky.colors import cluster_sky_colors, write_sky_colors
from cherrypicker.sky.masks import MaskOptions
from cherrypicker.sky.scan import mask_photos
from cherrypicker.sky.unet import load_weights

logger = logging.getLogger(__name__)
SHIPPED = Path(__file__).resolve().parents[1] / "resources/weights/sky_unet.npz"


def main(
    photo_folder: Annotated[str, "folder of photos"],
    masks: Annotated[str, "folder of masks to write"],
    colors: Annotated[str, "sky colours to write (NPZ)"],
    photo_masks: Annotated[str | None, "folder of the photos' masks by a user"] = None,
    *,
    weights: str = "",
    options: MaskOptions,
    seed: int = 0,
    threads: int = 2,
) -> None:
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    samples = mask_photos(
        load_weights(weights or SHIPPED),
        Path(photo_folder),
        Path(masks),
        options,
        seed=seed,
        photo_masks=Path(photo_masks) if photo_masks else None,
    )
    sky = cluster_sky_colors(samples, seed=seed)
    if sky.n_clusters == 0:
        logger.info("no sky in this scan: no sky colours to filter points by")
    for number, fraction in enumerate(sky.fraction):
        mean = sky.colors[sky.cluster == number].mean(axis=0) * 255
        share = 100 * fraction
        logger.info("sky colour %d: %.1f %% of the sky, mean RGB %s", number, share, mean.round())
    write_sky_colors(colors, sky)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
