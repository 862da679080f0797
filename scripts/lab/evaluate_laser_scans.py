"""Measure the segmentation on laser scans of real trees, which have weak labels or none.

Prints a table: the share of the points found to be wood (all of them are), and F1 of trunk and
branch against weak labels where there are any. Writes it as JSON. Example:

    python scripts/lab/evaluate_laser_scans.py --weights resources/weights/dgcnn.pt \
        --clouds data/clouds --output laser.json
"""

import logging
from pathlib import Path

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.classes import CLASS_NAMES, WOOD, wood_mask
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker.segmentation.dgcnn import choose_device
from cherrypicker.segmentation.inference import Sampling, segment_cloud
from cherrypicker_lab.training.segmentation.metrics import confusion_matrix, scores
from cherrypicker_lab.training.segmentation.training import network_labels
from cherrypicker_lab.training.segmentation.weak_labels import SCANS, read_scan

logger = logging.getLogger("cherrypicker")


def main(weights, clouds, *, output, seed, threads):
    settings = {"sampling": Sampling(), "seed": seed, "device": choose_device(threads, 0)}
    rows = []
    for scan in SCANS:
        cloud, truth = read_scan(scan, clouds)
        labels = segment_cloud(cloud, weights, **settings)[0]["label"]
        rows.append(_row(Path(scan.cloud).stem, cloud, labels, truth))
    text = _table(rows)
    logger.info("laser scans of real trees\n%s", text)
    if output:
        write_json(output, {"weights": Path(weights).name, "table": text, "scans": rows})


def _row(name, cloud, labels, truth):
    others = {
        CLASS_NAMES[int(c)]: float((labels == c).mean()) for c in np.unique(labels) if c not in WOOD
    }
    row = {
        "scan": name,
        "n_points": len(cloud),
        "height_m": float(np.ptp(cloud.points[:, 2])),
        "wood": float(wood_mask(labels).mean()),
        "others": others,
    }
    if truth is not None:
        classes = scores(confusion_matrix(truth, network_labels(labels)))["classes"]
        row |= {kind: classes[kind]["f1"] for kind in ("trunk", "branch")}
    return row


def _table(rows):
    lines = [
        "| scan | points | height, m | found to be wood | trunk F1 | branch F1 | else found |",
        "|---|---:|---:|---:|---:|---:|---|",
    ]
    for row in rows:
        f1 = [f"{row[kind]:.3f}" if kind in row else "-" for kind in ("trunk", "branch")]
        large = {k: v for k, v in row["others"].items() if v >= 0.005}
        others = ", ".join(f"{k.replace('_', ' ')} {100 * v:.1f} %" for k, v in large.items())
        lines.append(
            f"| {row['scan']} | {row['n_points']:,} | {row['height_m']:.1f} | "
            f"{100 * row['wood']:.1f} % | {f1[0]} | {f1[1]} | {others} |"
        )
    return "\n".join(lines)


parser = stage_parser(__doc__)
parser.add_argument("--weights", required=True, help="weights to measure")
parser.add_argument("--clouds", required=True, help="folder clouds of the real data")
parser.add_argument("--output", default="", help="JSON to write")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
run(main, parser, globals().get("snakemake"))
