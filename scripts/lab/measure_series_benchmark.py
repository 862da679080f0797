"""Grow a tree, prune it and let a year pass, see it at each date, compare, and judge by the truth.

Writes JSON. Example:

    python scripts/lab/measure_series_benchmark.py --tree_seed 7200 --walk seen --pairs pairs.json
"""

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.series.pairs import measure_pairs


def main(pairs, *, tree_seed, walk, n_points=100_000):
    write_json(pairs, measure_pairs(tree_seed, n_points, walk))


parser = stage_parser(__doc__)
parser.add_argument("--tree_seed", type=int, required=True, help="of the tree")
parser.add_argument("--walk", required=True, choices=["noise", "seen"], help="how it is seen")
parser.add_argument("--n_points", type=int, default=100_000, help="of a cloud")
parser.add_argument("--pairs", required=True, help="JSON to write")
run(main, parser, globals().get("snakemake"))
