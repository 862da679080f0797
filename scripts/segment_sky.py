"""Tell sky from everything else in every photo, and find the sky's dominant colours.

Reads the folder of photos and the sky network's weights, writes one mask per photo
(``{stem}.png``, 255 = sky, in the pixels of the photo as COLMAP reads it) and
``sky_colors.npz``. Example:

    python scripts/segment_sky.py --photo_folder photos/tree_1 --masks results/tree_1/sky \\
        --colors results/tree_1/sky_colors.npz
"""

import logging
from pathlib import Path

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
    photo_folder,
    weights,
    masks,
    colors,
    *,
    working_side_px,
    threshold,
    guide_radius_px,
    guide_epsilon,
    color_weight,
    twig_contrast,
    n_color_samples,
    cluster_epsilon,
    cluster_min_density,
    cluster_min_fraction,
    seed,
    threads,
):
    """Load photos and weights, write masks and sky colours."""
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    options = MaskOptions(
        working_side_px=working_side_px,
        threshold=threshold,
        guide_radius_px=guide_radius_px,
        guide_epsilon=guide_epsilon,
        color_weight=color_weight,
        twig_contrast=twig_contrast,
    )
    samples = mask_photos(
        load_weights(weights),
        Path(photo_folder),
        Path(masks),
        options,
        n_samples=n_color_samples,
        seed=seed,
    )
    sky = cluster_sky_colors(
        samples,
        epsilon=cluster_epsilon,
        min_density=cluster_min_density,
        min_fraction=cluster_min_fraction,
        seed=seed,
    )
    if sky.n_clusters == 0:
        logger.info("no sky in this scan: no sky colours to filter points by")
    for number, fraction in enumerate(sky.fraction):
        mean = sky.colors[sky.cluster == number].mean(axis=0) * 255
        share = 100 * fraction
        logger.info("sky colour %d: %.1f %% of the sky, mean RGB %s", number, share, mean.round())
    write_sky_colors(colors, sky)


parser = stage_parser(__doc__)
parser.add_argument("--photo_folder", required=True, help="folder of photos")
parser.add_argument("--weights", default=str(SHIPPED), help="network weights (NPZ)")
parser.add_argument("--masks", required=True, help="folder of masks to write")
parser.add_argument("--colors", required=True, help="sky colours to write (NPZ)")
parser.add_argument("--working_side_px", type=int, default=800)
parser.add_argument("--threshold", type=float, default=0.5)
parser.add_argument("--guide_radius_px", type=int, default=5)
parser.add_argument("--guide_epsilon", type=float, default=3e-4)
parser.add_argument("--color_weight", type=float, default=0.5)
parser.add_argument("--twig_contrast", type=float, default=0.09)
parser.add_argument("--n_color_samples", type=int, default=20000)
parser.add_argument("--cluster_epsilon", type=float, default=0.02)
parser.add_argument("--cluster_min_density", type=float, default=0.001)
parser.add_argument("--cluster_min_fraction", type=float, default=0.02)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
run(main, parser, globals().get("snakemake"))
