"""Measure a tree's results against the ground truth of its scene.

Reads results/TREE and SCENE/truth (poses.npz, skeleton.csv, traits.json, cloud.ply), prints every
number beside its bar and writes them as JSON. With --check a missed bar makes the exit code 1.
Example:

    python scripts/lab/evaluate_scene.py --results results/cherry_leader \\
        --truth resources/demo/cherry_leader/truth --check
"""

import logging
import sys
from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.files import write_json
from cherrypicker.runner import stage_parser
from cherrypicker_lab.evaluation import BARS, evaluate, missed_bars


def main(results, truth, output=None, *, check=False):
    report = evaluate(results, truth)
    missed = {bar.name for bar in missed_bars(report)}
    report["missed"] = sorted(missed)
    print_report(report, missed)
    write_json(output or Path(results) / "evaluation.json", report)
    return 1 if check and missed else 0


def print_report(report, missed):
    for bar in BARS:
        if bar.name not in report:
            continue
        sign = ">=" if bar.is_least else "<="
        verdict = "MISSED" if bar.name in missed else "ok"
        print(f"{verdict:7s} {bar.what:58s} {report[bar.name]:10.4g} {sign} {bar.limit:g}")
    bars = {bar.name for bar in BARS}
    for name, value in report.items():
        if name not in bars and name != "missed":
            print(
                f"        {name:58s} {value:10.4g}"
                if is_number(value)
                else f"{'':8s}{name} {value}"
            )


def is_number(value):
    return isinstance(value, int | float) and not isinstance(value, bool)


parser = stage_parser(__doc__)
parser.add_argument("--results", required=True, help="results/TREE")
parser.add_argument("--truth", required=True, help="SCENE/truth")
parser.add_argument("--output", help="JSON to write, results/TREE/evaluation.json by default")
parser.add_argument("--check", action="store_true", help="exit with 1 when a bar is missed")

if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        sys.exit(main(**vars(parser.parse_args())))
    except StageError as error:
        sys.exit(f"error: {error.describe()}")
