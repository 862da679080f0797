"""Score a cloud against the true surface of a rendered scene.

Reads a cloud, the camera poses of its frame (poses NPZ) and SCENE/truth; prints accuracy,
completeness and F1 at 5, 10 and 20 mm for all wood, the trunk and branches by radius, and writes
them as JSON. Definitions: cherrypicker_lab/dense/surface.py. Example:

    python scripts/lab/score_surface.py --cloud results/tree/metric.ply \\
        --poses results/tree/metric_poses.npz --truth scenes/tree/truth --scores scores.json
"""

import logging
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.dense.surface import describe, score_file


def main(
    cloud: Annotated[str, "cloud to score, PLY"],
    truth: Annotated[str, "SCENE/truth"],
    scores: Annotated[str, "JSON to write"] = "",
    poses: Annotated[str, "poses NPZ of its frame, where it is not the truth's"] = "",
) -> None:
    """Place the cloud, score it, print and save."""
    report = score_file(cloud, truth, poses)
    logging.getLogger("cherrypicker").info("%s\n%s", cloud, describe(report))
    if scores:
        write_json(scores, report)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
