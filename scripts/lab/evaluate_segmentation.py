"""Measure the segmentation on generated scenes and scans that it was not trained on.

Prints a table (F1 a class and mean IoU a set of clouds), writes it and the confusion matrices as
JSON. Example:

    python scripts/lab/evaluate_segmentation.py --weights resources/weights/dgcnn.pt \\
        --workspace work --scans results/cherry_vase=resources/demo/cherry_vase/truth
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.classes import wood_mask
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker.segmentation.dgcnn import N_CLASSES, choose_device
from cherrypicker.segmentation.inference import Sampling
from cherrypicker_lab.training.segmentation.held_out import (
    judge,
    of_sample,
    of_scans,
    table,
)
from cherrypicker_lab.training.segmentation.random_props import NO_WOOD
from cherrypicker_lab.training.segmentation.scenes import HELD_OUT_SEED, load_samples

TEMPLATES = ("cherry_whip", "fir", "larch", "pine")  # forms that the training never draws
logger = logging.getLogger("cherrypicker")


def main(
    weights: Annotated[str, "weights to measure"],
    workspace: Annotated[str, "folder that keeps the generated scenes"],
    output: Annotated[str, "JSON to write"] = "",
    scans: Annotated[Sequence[str], "RESULTS=TRUTH of rendered scenes"] = (),
    n_scenes: Annotated[int, "scenes of held-out seeds"] = 10,
    n_templates: Annotated[int, "scenes of forms never trained on, seeds 500 above"] = 8,
    n_random: Annotated[int, "scenes of things drawn at random, 600 above"] = 6,
    n_hard: Annotated[int, "scenes of what networks get wrong, 750 above"] = 0,
    trees: Annotated[Sequence[str], "skeletons from elsewhere, two scenes each, 700 above"] = (),
    first_seed: Annotated[int, "of the scenes"] = HELD_OUT_SEED,
    scene_points: Annotated[int, "of a scene at most"] = 250_000,
    *,
    seed: int = 0,
    threads: int = 2,
    gpu: int = 0,
) -> None:
    settings = {"sampling": Sampling(), "seed": seed, "device": choose_device(threads, gpu)}
    folder = Path(workspace)
    generated = {
        "held-out seeds": (0, n_scenes, {}),
        "held-out forms": (500, n_templates, {"habits": TEMPLATES}),
        "things at random": (600, n_random, {"things": "random"}),
        "hard things": (750, n_hard, {"things": "hard"}),
    }
    sets = {}
    for name, (shift, n, options) in generated.items():
        if n:
            seeds = range(first_seed + shift, first_seed + shift + n)
            samples = load_samples(seeds, folder, scene_points, **options)
            sets[name] = [of_sample(name, sample) for sample in samples]
    if trees:
        sets["trees from elsewhere"] = []
        for number, skeleton in enumerate(2 * sorted(trees)):
            options = {"things": "elsewhere", "skeletons": [skeleton]}
            samples = load_samples([first_seed + 700 + number], folder, scene_points, **options)
            sets["trees from elsewhere"] += [of_sample("elsewhere", each) for each in samples]
    sets |= {f"{one.name}, through photos": [one] for one in of_scans(scans)}
    confusions = {name: _sum(name, clouds, weights, settings) for name, clouds in sets.items()}
    text = table(confusions)
    logger.info("F1 a class\n%s", text)
    if output:
        found = {name: matrix.tolist() for name, matrix in confusions.items()}
        write_json(output, {"weights": Path(weights).name, "table": text} | found)


def _sum(name, clouds, weights, settings):
    """Confusion matrix over all clouds of a set."""
    total = np.zeros((N_CLASSES, N_CLASSES), np.int64)
    for number, labelled in enumerate(clouds):
        confusion, labels = judge(labelled, weights, **settings)
        total += confusion
        if (stray := labelled.truth == NO_WOOD).any():
            share = wood_mask(labels[stray]).mean()
            logger.info("%.1f %% of %d points of no class are wood", 100 * share, stray.sum())
        logger.info("%s, cloud %d\n%s", name, number, table({str(number): confusion}))
    logger.info("measured: %s (%d clouds)", name, len(clouds))
    return total


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
