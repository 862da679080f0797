"""Measure the segmentation on generated scenes and scans that it was not trained on.

Prints a table (F1 a class and mean IoU a set of clouds), writes it and the confusion matrices as
JSON. Example:

    python scripts/lab/evaluate_segmentation.py --weights resources/weights/dgcnn.pt \\
        --workspace work --scan results/cherry_vase=resources/demo/cherry_vase/truth
"""

import logging
from pathlib import Path

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
    weights,
    workspace,
    *,
    output,
    scans,
    n_scenes,
    n_templates,
    n_random,
    n_hard,
    trees,
    first_seed,
    scene_points,
    seed,
    threads,
    gpu,
):
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


parser = stage_parser(__doc__)
parser.add_argument("--weights", required=True, help="weights to measure")
parser.add_argument("--workspace", required=True, help="folder that keeps the generated scenes")
parser.add_argument("--output", default="", help="JSON to write")
parser.add_argument(
    "--scan", dest="scans", action="append", default=[], help="RESULTS=TRUTH of a rendered scene"
)
parser.add_argument("--n_scenes", type=int, default=10)
parser.add_argument("--n_templates", type=int, default=8)
parser.add_argument("--n_random", type=int, default=6, help="scenes of things drawn at random")
parser.add_argument("--n_hard", type=int, default=0, help="scenes of what networks get wrong")
parser.add_argument(
    "--trees", nargs="*", default=(), help="skeletons of trees from elsewhere, two scenes each"
)
parser.add_argument(
    "--first_seed",
    type=int,
    default=HELD_OUT_SEED,
    help="of the scenes; the forms' is 500 above, that of things at random 600, elsewhere 700, "
    "hard things 750",
)
parser.add_argument("--scene_points", type=int, default=250_000)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
parser.add_argument("--gpu", type=int, default=0, help="1 to use an NVIDIA GPU")
run(main, parser, globals().get("snakemake"))
