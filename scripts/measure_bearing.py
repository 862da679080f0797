"""Tell the bearing wood of a tree: shoots, spurs, two-year and older wood, by axis and by limb.

Reads skeleton.graphml with branches.csv and, from photos, photo_check.json beside it, limbs.csv and
traits.json; writes bearing.csv, a row a piece of an axis, and bearing.json, the tree and its limbs.
Example:

    python scripts/measure_bearing.py --skeleton results/TREE/skeleton.graphml \\
        --limbs results/TREE/limbs.csv --traits results/TREE/traits.json \\
        --pieces bearing.csv --bearing bearing.json
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.bearing.measure import COLUMNS, measure_bearing
from cherrypicker.files import csv_text, read_json, write_json, write_text
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.runner import run, stage_parser
from cherrypicker.traits.branches import read_branches
from cherrypicker.traits.table import LIMB_COLUMNS


def main(
    skeleton: Annotated[str, "skeleton.graphml, with branches.csv and photo_check.json beside it"],
    limbs: Annotated[str, "limbs.csv"],
    traits: Annotated[str, "traits.json"],
    pieces: Annotated[str, "bearing.csv to write"],
    bearing: Annotated[str, "bearing.json to write"],
) -> None:
    tree = read_measured_tree(Path(skeleton).parent)
    trunk_area = read_json(traits).get("tcsa_cm2")
    totals, rows = measure_bearing(tree, read_branches(limbs, LIMB_COLUMNS), trunk_area)
    write_text(pieces, csv_text(rows, COLUMNS))
    write_json(bearing, totals)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
