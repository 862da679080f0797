"""Measure the segmentation on laser scans of real trees, which have weak labels or none.

Prints a table: the share of the points found to be wood (all of them are), and F1 of trunk and
branch against weak labels where there are any. Writes it as JSON, and a picture. Example:

    python scripts/lab/evaluate_laser_scans.py --weights resources/weights/dgcnn.pt \
        --clouds data/clouds --output laser.json --figure laser.png
"""

import logging
from pathlib import Path

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.classes import CLASS_NAMES, WOOD
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker.segmentation.dgcnn import choose_device
from cherrypicker.segmentation.inference import Sampling, segment_cloud
from cherrypicker_lab.training.segmentation.held_out import labels_figure
from cherrypicker_lab.training.segmentation.metrics import confusion_matrix, scores
from cherrypicker_lab.training.segmentation.training import network_labels
from cherrypicker_lab.training.segmentation.weak_labels import SCANS, read_scan, wood_share

logger = logging.getLogger("cherrypicker")


def main(weights, clouds, *, output, figure, only, most_points, seed, threads, gpu):
    settings = {
        "sampling": Sampling(),
        "seed": seed,
        "device": choose_device(threads, gpu),
    }
    rows, panels = [], []
    for scan in SCANS:
        name = Path(scan.cloud).stem
        if only and name not in only:
            continue
        cloud, truth = read_scan(scan, clouds)
        if len(cloud) > most_points:
            keep = np.random.default_rng(seed).permutation(len(cloud))[:most_points]
            cloud, truth = cloud.select(keep), None if truth is None else truth[keep]
        labels = segment_cloud(cloud, weights, **settings)[0]["label"]
        rows.append(_row(name, cloud, labels, truth))
        middle = np.median(cloud.points, axis=0) * [1, 1, 0]
        size = np.abs(cloud.points - middle)[:, :2].max()
        panels.append((f"{name}, found", (cloud.points - middle) / size, labels))
        if truth is not None:
            panels.append((f"{name}, weak labels", (cloud.points - middle) / size, truth))
    text = _table(rows)
    logger.info("laser scans of real trees\n%s", text)
    if output:
        write_json(output, {"weights": Path(weights).name, "table": text, "scans": rows})
    if figure:
        labels_figure(figure, panels, columns=6)


def _row(name, cloud, labels, truth):
    others = {
        CLASS_NAMES[int(c)]: float((labels == c).mean()) for c in np.unique(labels) if c not in WOOD
    }
    row = {
        "scan": name,
        "n_points": len(cloud),
        "height_m": float(np.ptp(cloud.points[:, 2])),
        "wood": wood_share(labels),
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
parser.add_argument("--figure", default="", help="PNG of the labels to write")
parser.add_argument("--only", nargs="*", default=(), help="names of scans; all by default")
parser.add_argument("--most_points", type=int, default=4_000_000, help="thinned to, at random")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
parser.add_argument("--gpu", type=int, default=0, help="1 to use an NVIDIA GPU")
run(main, parser, globals().get("snakemake"))
