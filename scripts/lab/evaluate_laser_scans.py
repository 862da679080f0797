"""Measure the segmentation on laser scans of real trees, which have weak labels or none.

Prints a table: the share of the points found to be wood (all of them are), and F1 of trunk and
branch against weak labels where there are any. Writes it as JSON. Example:

    python scripts/lab/evaluate_laser_scans.py --weights resources/weights/dgcnn.pt \
        --clouds data/clouds --output laser.json
"""

import logging
from pathlib import Path
from typing import Annotated

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.classes import CLASS_NAMES, WOOD, wood_mask
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker.segmentation.dgcnn import choose_device
from cherrypicker.segmentation.inference import Sampling, segment_cloud
from cherrypicker_lab.tables import markdown_table
from cherrypicker_lab.training.segmentation.metrics import confusion_matrix, scores
from cherrypicker_lab.training.segmentation.training import network_labels
from cherrypicker_lab.training.segmentation.weak_labels import SCANS, read_scan

logger = logging.getLogger("cherrypicker")


def main(
    weights: Annotated[str, "weights to measure"],
    clouds: Annotated[str, "folder clouds of the real data"],
    output: Annotated[str, "JSON to write"] = "",
    *,
    seed: int = 0,
    threads: int = 2,
) -> None:
    settings = {"sampling": Sampling(), "seed": seed, "device": choose_device(threads, 0)}
    rows, lines = [], []
    for scan in SCANS:
        cloud, truth = read_scan(scan, clouds)
        labels = segment_cloud(cloud, weights, **settings)[0]["label"]
        others = {c: float((labels == c).mean()) for c in np.unique(labels) if c not in WOOD}
        row = {
            "scan": Path(scan.cloud).stem,
            "n_points": len(cloud),
            "height_m": float(np.ptp(cloud.points[:, 2])),
            "wood": float(wood_mask(labels).mean()),
            "others": {CLASS_NAMES[int(c)]: share for c, share in others.items()},
        }
        if truth is not None:
            classes = scores(confusion_matrix(truth, network_labels(labels)))["classes"]
            row |= {kind: classes[kind]["f1"] for kind in ("trunk", "branch")}
        f1 = [f"{row[kind]:.3f}" if kind in row else "-" for kind in ("trunk", "branch")]
        large = {k.replace("_", " "): 100 * v for k, v in row["others"].items() if v >= 0.005}
        lines.append(
            [
                row["scan"],
                f"{row['n_points']:,}",
                f"{row['height_m']:.1f}",
                f"{100 * row['wood']:.1f} %",
                *f1,
                ", ".join(f"{name} {share:.1f} %" for name, share in large.items()),
            ]
        )
        rows.append(row)
    names = ["scan", "points", "height, m", "found to be wood", "trunk F1", "branch F1",
             "else found"]  # fmt: skip
    text = markdown_table(names, lines)
    logger.info("laser scans of real trees\n%s", text)
    if output:
        write_json(output, {"weights": Path(weights).name, "table": text, "scans": rows})


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
