"""Score the sky masks that the pipeline makes against reference masks.

Reads every images/ or photos/ folder with a masks/ folder beside it below the given folders (equal
stems, 255 = sky), makes each photo's mask as segment_sky does, and prints per folder F1 of sky and
ground over all pixels as they are labelled, and, where the masks are exact, how much of the sky
between twigs is found and how many twig pixels are called sky. Example:

    python scripts/lab/score_sky.py --folders data/sky/camvid --only "camvid/0001TP*" \\
        --scores scores.json
"""

import fnmatch
import logging
import time
from collections.abc import Sequence
from typing import Annotated

import cv2
import torch

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker.sky.masks import MaskOptions, sky_mask
from cherrypicker.sky.unet import load_weights
from cherrypicker_lab.training.sky.data import load_photos
from cherrypicker_lab.training.sky.metrics import Confusion, CrownScores

#: Photos are not reduced: no camera's are larger.
MAX_SIDE = 100_000
logger = logging.getLogger(__name__)


def main(
    folders: Annotated[Sequence[str], "folders of photos with masks"],
    weights: Annotated[str, "network weights (NPZ)"],
    scores: Annotated[str, "JSON to write"] = "",
    only: Annotated[Sequence[str], "name patterns (folder/file) to score"] = (),
    *,
    threads: int = 1,
) -> None:
    """Load photos, mask them, compare, print and save."""
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    net, report = load_weights(weights), {}
    for folder in folders:
        photos = load_photos([folder], MAX_SIDE)
        photos = [p for p in photos if not only or any(fnmatch.fnmatch(p.name, o) for o in only)]
        confusion, crowns, start = Confusion(), CrownScores(), time.process_time()
        for photo in photos:
            mask = sky_mask(net, photo.image, MaskOptions()) > 0
            confusion.add(mask.astype("float32"), photo.sky)
            crowns.add(mask, photo.sky)
        if not photos:
            raise StageError("no photo of the folder is asked for", file=folder)
        report[folder] = {
            "n_photos": len(photos),
            "cpu_s_a_photo": (time.process_time() - start) / len(photos),
            **confusion.summary(),
            "counts": confusion.counts.tolist(),
            **crowns.summary(),
        }
        logger.info("%s: %s", folder, report[folder])
    if scores:
        write_json(scores, report)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
