"""Turn each pass after the network off, alone and all together, and measure what that costs.

Prints a table and writes it as JSON: F1 of wood against all else and of each class, and length,
height and tips of the skeleton that follows, each beside those of the stage as it is. Clouds are
scans with a truth (as in evaluate_segmentation.py) and generated scenes of held-out seeds. Example:

    python scripts/lab/ablate_labels.py --weights resources/weights/dgcnn.pt --workspace work \
        --scans results/cherry_leader=resources/demo/cherry_leader/truth --output ablation.json
"""

import logging
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated
from unittest.mock import patch

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.classes import CLASS_NAMES, Label, wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker.segmentation import inference, stems, things
from cherrypicker.segmentation.dgcnn import choose_device
from cherrypicker.segmentation.inference import Sampling, segment_cloud
from cherrypicker_lab.evaluation import f1
from cherrypicker_lab.skeletons.methods import find_skeleton
from cherrypicker_lab.tables import markdown_table
from cherrypicker_lab.training.segmentation.held_out import of_sample, of_scans
from cherrypicker_lab.training.segmentation.scenes import HELD_OUT_SEED, load_samples

logger = logging.getLogger("cherrypicker")


def _unchanged(points, probabilities, *_):
    return probabilities


def _nothing(*_):
    return None


# What stands in the place of each pass: module, its function, and what does nothing
PASSES = {
    "vote of neighbours": (inference, "smooth_probabilities", _unchanged),
    "roofs are flat": (inference, "keep_roofs", _unchanged),
    "rims of boards": (things, "_grow_rims", lambda *_: np.empty(0, int)),
    "vote per object": (inference, "vote_per_object", _unchanged),
    "loose wood": (stems, "loose_wood", lambda points, labels, *_: labels),
    "posts by shape": (stems, "poles_and_wires", lambda *_, **__: np.empty(0, int)),
    "posts by word": (stems, "said_posts", lambda *_: (np.empty(0, int),) * 2),
    "stem below the stem": (stems, "under_stems", lambda *_, **__: np.empty(0, int)),
    "tubes claim": (stems, "claimed_by", lambda *_: (np.empty(0, int), np.empty(0, bool))),
    "down to the ground": (stems, "follow_down", _nothing),
    "white rings": (stems, "label_rings", _nothing),
}


def main(
    weights: Annotated[str, "weights to measure"],
    workspace: Annotated[str, "folder that keeps the generated scenes"],
    output: Annotated[str, "JSON to write"] = "",
    scans: Annotated[Sequence[str], "RESULTS=TRUTH of rendered scenes"] = (),
    n_scenes: Annotated[int, "generated scenes of held-out seeds"] = 0,
    n_random: Annotated[int, "scenes of things drawn at random"] = 0,
    n_hard: Annotated[int, "scenes of what the network got wrong"] = 0,
    *,
    seed: int = 0,
    threads: int = 2,
) -> None:
    folder, device = Path(workspace), choose_device(threads, 0)
    clouds = of_scans(scans)
    sets = ((100, n_scenes, "common"), (700, n_random, "random"), (800, n_hard, "hard"))
    for first, n, kind in sets:
        seeds = range(HELD_OUT_SEED + first, HELD_OUT_SEED + first + n)
        samples = load_samples(seeds, folder, things=kind) if n else []
        clouds += [of_sample(f"{kind} {s}", each) for s, each in zip(seeds, samples)]
    rows = []
    for labelled in clouds:
        original, known = inference.predict_spheres, []

        def once(*arguments, known=known, original=original, **options):
            if not known:
                known.append(original(*arguments, **options))
            return known[0].copy()

        with patch.object(inference, "predict_spheres", once):
            for off in ([], *([name] for name in PASSES), list(PASSES)):
                row = _measure(labelled, weights, off, seed=seed, device=device)
                rows.append(row)
                logger.info("%s", " | ".join(_cells(row)))
    names = ["cloud", "off", *(name.replace("_", " ") for name in (*COLUMNS, *SIZES))]
    text = markdown_table(names, map(_cells, rows), 2)
    logger.info("each pass turned off\n%s", text)
    if output:
        write_json(output, {"weights": Path(weights).name, "rows": rows, "table": text})


def _measure(labelled, weights, off, **settings):
    """F1 by class and the skeleton's size, with some passes off."""
    settings |= {"markers": labelled.markers, "region": labelled.region}
    with ExitStack() as stack:
        for name in off:
            stack.enter_context(patch.object(*PASSES[name]))
        cloud, orchard = segment_cloud(labelled.cloud, weights, sampling=Sampling(), **settings)
    known = labelled.truth <= max(CLASS_NAMES.keys() - {Label.UNLABELLED})
    truth, found = labelled.truth[known], np.asarray(cloud["label"])[known]
    row = {"cloud": labelled.name, "off": "all" if len(off) > 1 else "".join(off) or "none"}
    row["wood"] = f1(wood_mask(truth), wood_mask(found))
    for label in np.unique(truth):
        row[CLASS_NAMES[int(label)]] = f1(truth == label, found == label)
    try:
        skeleton, _ = find_skeleton(cloud, region=labelled.region, orchard=orchard)
        row["length_m"] = float(skeleton.edge_length.sum())
        row["height_m"] = float(np.ptp(skeleton.points[:, 2]))
        row["tips"] = int(np.count_nonzero(skeleton.degree == 1)) - 1
    except StageError as error:
        logger.warning("%s without %s: %s", labelled.name, row["off"], error)
    return row


COLUMNS = ("wood", "trunk", "branch", "sign", "marker", "calibration_unit", "roof", "support_post")
SIZES = ("length_m", "height_m", "tips")


def _cells(row):
    """Cells of a line of the table."""
    shares = [f"{row[name]:.3f}" if name in row else "-" for name in COLUMNS]
    sizes = [f"{row[name]:.2f}".removesuffix(".00") if name in row else "-" for name in SIZES]
    return [row["cloud"], row["off"], *shares, *sizes]


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
