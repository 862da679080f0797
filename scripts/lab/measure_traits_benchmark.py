"""Grow a tree, see it, measure its traits as the workflow does, and put the truth beside them.

Writes JSON. Example:

    python scripts/lab/measure_traits_benchmark.py --tree_seed 6000 --pairs pairs.json
"""

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.traits.benchmark import measure_tree


def main(pairs, *, tree_seed, n_points=100_000, bearing=False):
    write_json(pairs, measure_tree(tree_seed, n_points, bearing=bearing))


parser = stage_parser(__doc__)
parser.add_argument("--tree_seed", type=int, required=True, help="of the tree")
parser.add_argument("--n_points", type=int, default=100_000, help="of the cloud")
parser.add_argument("--bearing", action="store_true", help="a tree of thick wood")
parser.add_argument("--pairs", required=True, help="JSON to write")
run(main, parser, globals().get("snakemake"))
