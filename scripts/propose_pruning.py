"""Propose the cuts that bring a tree to a pruning target, in order.

Reads skeleton.graphml with branches.csv and, from photos, photo_check.json beside it, limbs.csv and
traits.json, and light.json where there is one, for shaded limbs and the light after each cut;
writes pruning.csv, a row a cut, and pruning.json, the target, what it was before and what is left.
Example:

    python scripts/propose_pruning.py --skeleton results/TREE/skeleton.graphml \\
        --limbs results/TREE/limbs.csv --traits results/TREE/traits.json \\
        --cuts pruning.csv --pruning pruning.json --preset ltr_100
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.files import read_json, write_json, write_text
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.pruning.light_left import add_light_left
from cherrypicker.pruning.plan import propose_cuts
from cherrypicker.pruning.standing import StandingTree
from cherrypicker.pruning.table import CUT_COLUMNS
from cherrypicker.pruning.target import PruningOptions, resolve_target
from cherrypicker.runner import run, stage_parser
from cherrypicker.traits.branches import branches_csv, read_branches
from cherrypicker.traits.table import LIMB_COLUMNS


def main(
    skeleton: Annotated[str, "skeleton.graphml, with branches.csv and photo_check.json beside it"],
    limbs: Annotated[str, "limbs.csv"],
    traits: Annotated[str, "traits.json"],
    cuts: Annotated[str, "pruning.csv to write"],
    pruning: Annotated[str, "pruning.json to write"],
    light: Annotated[str | None, "light.json, for shaded limbs and the light left"] = None,
    *,
    options: PruningOptions,
    threads: int = 1,
) -> None:
    tree = read_measured_tree(Path(skeleton).parent)
    limb_rows = read_branches(limbs, LIMB_COLUMNS)
    target = resolve_target(options, len(limb_rows), tree.skeleton.unit)
    standing = StandingTree(
        tree,
        read_branches(Path(skeleton).with_name("branches.csv")),
        limb_rows,
        read_json(traits),
        stub=target.stub,
        least_limb=options.min_limb_m,
        row_azimuth_deg=options.row_azimuth_deg,
    )
    measured = read_json(light) if light else None
    summary, rows = propose_cuts(standing, target, keep=options.keep, light=measured)
    if measured:
        add_light_left(standing, summary, rows, measured, threads=threads)
    write_text(cuts, branches_csv(rows, CUT_COLUMNS))
    write_json(pruning, summary)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
