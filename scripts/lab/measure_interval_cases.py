"""Measure the traits of one tree whose truth is known, for the fit of their 90 % intervals.

Grows a tree, or reads a finished scan from photos (results/TREE) and its truth (poses.npz,
skeleton.csv); writes JSON. Examples:

    python scripts/lab/measure_interval_cases.py --source thin --number 6100 --cases thin.json
    python scripts/lab/measure_interval_cases.py --source demo --results results/cherry_vase \\
        --truth resources/demo/cherry_vase/truth --cases vase.json
"""

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.traits.cases import grown_cases, scan_cases


def main(cases, *, source, number=0, n_points=100_000, results="", truth=""):
    if results:
        found = scan_cases(source, results, truth)
    else:
        found = grown_cases(source, number, n_points)
    write_json(cases, {"cases": found}, indent=None)


parser = stage_parser(__doc__)
parser.add_argument("--source", required=True, help="set of trees: thin, bearing, conifer, or any")
parser.add_argument("--number", type=int, default=0, help="of a grown tree")
parser.add_argument("--n_points", type=int, default=100_000, help="of a grown tree's cloud")
parser.add_argument("--results", default="", help="results/TREE of a scan")
parser.add_argument("--truth", default="", help="the truth of its scene")
parser.add_argument("--cases", required=True, help="JSON to write")
run(main, parser, globals().get("snakemake"))
