"""Measure the light that a tree's axes and limbs receive.

Reads skeleton.graphml with branches.csv and, from photos, photo_check.json beside it, and
limbs.csv; writes light.csv, a row an axis, and light.json, the tree and its limbs. Example:

    python scripts/measure_light.py --skeleton results/TREE/skeleton.graphml \\
        --limbs results/TREE/limbs.csv --axes light.csv --light light.json --leaf_area_cm2 40
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.files import csv_text, write_json, write_text
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.light.measure import LightOptions, measure_light
from cherrypicker.runner import run, stage_parser
from cherrypicker.traits.branches import read_branches
from cherrypicker.traits.table import LIMB_COLUMNS


def main(
    skeleton: Annotated[str, "skeleton.graphml, with branches.csv and photo_check.json beside it"],
    limbs: Annotated[str, "limbs.csv"],
    axes: Annotated[str, "light.csv to write"],
    light: Annotated[str, "light.json to write"],
    *,
    options: LightOptions,
    seed: int = 0,
    threads: int = 1,
) -> None:
    tree = read_measured_tree(Path(skeleton).parent)
    starts = [row["branch_id"] for row in read_branches(limbs, LIMB_COLUMNS)]
    totals, of_axes = measure_light(tree, starts, options, seed=seed, threads=threads)
    write_text(axes, csv_text(of_axes, of_axes[0]))
    write_json(light, totals)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
