"""Measure how far the generator's trunk label and the graph's order 0 agree.

Both follow one rule (`cherrypicker.skeleton.axes`); here the true skeletons of generated trees are
split into axes as the graph stage splits them, and every point of the true surface is compared: its
label against the order of the nearest wood. Prints a table by form. Example:

    python scripts/lab/measure_trunk_definition.py --first_seed 920000 --n_trees 5 \\
        --output order.json
"""

import logging

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.classes import Label, wood_mask
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker.skeleton.model import Skeleton
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.seen.sampling import sample_scene
from cherrypicker_lab.training.segmentation.metrics import confusion_matrix, scores
from cherrypicker_lab.training.segmentation.weak_labels import wood_by_order

FORMS = (
    "leader", "spindle", "vase", "cherry_leader", "cherry_spindle", "cherry_vase", "cherry_whip",
    "fir", "larch", "pine",
)  # fmt: skip
BARE = {"neighbours": 0, "sign": False, "ring": False, "cube": False, "post": False, "roof": False}
logger = logging.getLogger("cherrypicker")


def main(*, output, first_seed, n_trees, points, forms):
    lines = [
        "| form | trees | trunk F1 | branch F1 | lowest trunk F1 |",
        "|---|---:|---:|---:|---:|",
    ]
    report = {}
    for form in forms or FORMS:
        singles = [_one(form, seed, points) for seed in range(first_seed, first_seed + n_trees)]
        classes = scores(np.sum(singles, axis=0))["classes"]
        each = [scores(one)["classes"]["trunk"]["f1"] for one in singles]
        report[form] = {"trunk": classes["trunk"]["f1"], "branch": classes["branch"]["f1"]}
        report[form]["trees"] = each
        lines.append(
            f"| {form.replace('_', ' ')} | {n_trees} | {classes['trunk']['f1']:.3f} | "
            f"{classes['branch']['f1']:.3f} | {min(each):.3f} |"
        )
    text = "\n".join(lines)
    logger.info("the label trunk against order 0 of the true skeleton\n%s", text)
    if output:
        write_json(output, {"table": text, "forms": report})


def _one(form, seed, n_points):
    """Confusion of one tree, by channel: labels as the truth, order 0 as what was found."""
    scene = generate_scene(seed, habit=form, markers=[], **BARE)
    cloud = sample_scene(scene, n_points, exact=True, ground_share=0.02)
    true = scene.target.skeleton()
    skeleton = Skeleton(
        true.points, true.parents, true.radii, np.full(len(true.points), int(Label.BRANCH))
    )
    wood = wood_mask(cloud["label"])
    found = wood_by_order(np.asarray(cloud.points[wood], float), skeleton)
    return confusion_matrix(cloud["label"][wood], found)


parser = stage_parser(__doc__)
parser.add_argument("--output", default="", help="JSON to write")
parser.add_argument("--first_seed", type=int, default=920_000)
parser.add_argument("--n_trees", type=int, default=5, help="of each form")
parser.add_argument("--points", type=int, default=60_000)
parser.add_argument("--forms", nargs="*", default=(), help="all by default")
run(main, parser, globals().get("snakemake"))
