"""Measure rows of generated trees with touching crowns: whose wood is whose, trunks and heights.

Example:

    python scripts/lab/measure_rows.py --seeds 41 42 43 --output rows.json
"""

from collections.abc import Sequence
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.traits.rows import measure_row, totals_of


def main(
    seeds: Annotated[Sequence[int], "rows to grow"],
    output: Annotated[str, "JSON to write"],
    n_points: Annotated[int, "points of a row's cloud"] = 300_000,
) -> None:
    """Grow, share out, measure, save."""
    rows = [measure_row(seed, n_points) for seed in seeds]
    trees = [tree for row in rows for tree in row["trees"]]
    n = {"n_trees": len(trees), "n_found": sum(tree["number"] > 0 for tree in trees)}
    write_json(output, {"totals": n | totals_of(trees), "rows": rows})


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
