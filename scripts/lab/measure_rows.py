"""Measure rows of generated trees with touching crowns: whose wood is whose, trunks and heights.

Example:

    python scripts/lab/measure_rows.py --seeds 41 42 43 --output rows.json
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.traits.rows import measure_row


def main(
    seeds: Annotated[Sequence[int], "rows to grow"],
    output: Annotated[str, "JSON to write"],
    n_points: Annotated[int, "points of a row's cloud"] = 300_000,
) -> None:
    """Grow, share out, measure, save."""
    rows = [measure_row(seed, n_points) for seed in seeds]
    trees = [tree for row in rows for tree in row["trees"]]
    off = [abs(t["trunk_diameter_m"] - t["trunk_diameter_m_true"]) for t in trees if t["number"]]
    totals = {
        "n_trees": len(trees),
        "n_found": len(off),
        "least_iou": min(tree["iou"] for tree in trees),
        "mean_iou": float(np.mean([tree["iou"] for tree in trees])),
        "most_wrong": max(tree["wrong"] for tree in trees),
        "trunk_mae_m": float(np.mean(off)),
    }
    write_json(output, {"totals": totals, "rows": rows})


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
