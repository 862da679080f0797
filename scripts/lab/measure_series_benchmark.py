"""Grow a tree, prune it and let a year pass, see it at each date, compare, and judge by the truth.

Writes JSON. Example:

    python scripts/lab/measure_series_benchmark.py --tree_seed 7200 --walk seen --pairs pairs.json
"""

from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.series.pairs import measure_pairs


def main(
    pairs: Annotated[str, "JSON to write"],
    tree_seed: Annotated[int, "of the tree"],
    walk: Annotated[str, "how it is seen: noise or seen"],
    n_points: Annotated[int, "of a cloud"] = 100_000,
) -> None:
    write_json(pairs, measure_pairs(tree_seed, n_points, walk))


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
