"""Grow trees, see them, propose cuts and cut by hand, and put the truth beside what is told.

Writes JSON, a record a tree. Example:

    python scripts/lab/measure_pruning.py --seeds 4700 4701 --bearing_seeds 4710 \\
        --series_seeds 7300 --found found.json
"""

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.pruning import measure_made, measure_pruning, measure_scan


def main(found, *, seeds=(), bearing_seeds=(), series_seeds=(), scans=(), n_points=100_000):
    bearing = dict.fromkeys(seeds, False) | dict.fromkeys(bearing_seeds, True)
    record = {
        "trees": [measure_pruning(seed, n_points, bearing=bearing[seed]) for seed in bearing],
        "made": [measure_made(seed, n_points) for seed in series_seeds],
    }
    record["scans"] = [measure_scan(*pair.split("=")) for pair in scans]
    write_json(found, record)


parser = stage_parser(__doc__)
parser.add_argument("--seeds", type=int, nargs="*", default=(), help="of trees of thin wood")
parser.add_argument("--bearing_seeds", type=int, nargs="*", default=(), help="of thick wood")
parser.add_argument("--series_seeds", type=int, nargs="*", default=(), help="scanned twice")
parser.add_argument("--scans", nargs="*", default=(), help="results/TREE=SCENE/truth")
parser.add_argument("--n_points", type=int, default=100_000, help="of each cloud")
parser.add_argument("--found", required=True, help="JSON to write")
run(main, parser, globals().get("snakemake"))
