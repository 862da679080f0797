"""Measure a tree's results against the ground truth of its scene.

Reads results/TREE and SCENE/truth (poses.npz, skeleton.csv, traits.json, cloud.ply), prints every
number beside its bar and writes them as JSON. With --check a missed bar makes the exit code 1.
Example:

    python scripts/lab/evaluate_scene.py --results results/cherry_leader \\
        --truth resources/demo/cherry_leader/truth --check
"""

from pathlib import Path
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.files import is_number, write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.evaluation import BARS, evaluate, missed_bars


def main(
    results: Annotated[str, "results/TREE"],
    truth: Annotated[str, "SCENE/truth"],
    output: Annotated[str, "JSON to write, results/TREE/evaluation.json by default"] = "",
    check: Annotated[bool, "fail where a bar is missed"] = False,
) -> None:
    """Compare, print every number, save."""
    report, numbers = evaluate(results, truth), {bar.name: bar for bar in BARS}
    missed = sorted(bar.name for bar in missed_bars(report))
    for name, bar in numbers.items():
        if name in report:
            sign, verdict = ">=" if bar.is_least else "<=", "MISSED" if name in missed else "ok"
            print(f"{verdict:7s} {bar.what:58s} {report[name]:10.4g} {sign} {bar.limit:g}")
    for name, value in report.items():
        if name in numbers:
            continue
        print(f"{'':8s}{name:58s} {value:10.4g}" if is_number(value) else f"{'':8s}{name} {value}")
    output = output or Path(results) / "evaluation.json"
    write_json(output, report | {"missed": missed})
    if check and missed:
        raise StageError(f"bars missed: {', '.join(missed)}", file=output)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
