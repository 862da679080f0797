"""Score a cloud against the true surface of a rendered scene.

Reads a cloud, the camera poses of its frame (poses NPZ) and SCENE/truth; prints accuracy,
completeness and F1 at 5, 10 and 20 mm for all wood, the trunk and branches by radius, and writes
them as JSON. Definitions: cherrypicker_lab/dense/surface.py. Example:

    python scripts/lab/score_surface.py --cloud results/tree/metric.ply \\
        --poses results/tree/metric_poses.npz --truth scenes/tree/truth --scores scores.json
"""

import logging

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.dense.scoring import describe, score_file


def main(cloud, truth, scores="", poses=""):
    """Place the cloud, score it, print and save."""
    report = score_file(cloud, truth, poses)
    logging.getLogger("cherrypicker").info("%s\n%s", cloud, describe(report))
    if scores:
        write_json(scores, report)


parser = stage_parser(__doc__)
parser.add_argument("--cloud", required=True, help="cloud to score, PLY")
parser.add_argument(
    "--poses", default="", help="poses NPZ of its frame, where it is not the truth's"
)
parser.add_argument("--truth", required=True, help="SCENE/truth")
parser.add_argument("--scores", default="", help="JSON to write")
run(main, parser, globals().get("snakemake"))
