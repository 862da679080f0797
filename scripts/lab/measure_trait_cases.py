"""Measure the traits of one tree whose truth is known: for their table, and to fit intervals to.

Grows a tree, or reads a finished scan from photos (results/TREE) and its truth (poses.npz,
skeleton.csv); writes JSON. Examples:

    python scripts/lab/measure_trait_cases.py --source thin --number 6100 --cases thin.json
    python scripts/lab/measure_trait_cases.py --source demo --results results/cherry_vase \\
        --truth resources/demo/cherry_vase/truth --cases vase.json
"""

from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.traits.benchmark import measure_grown
from cherrypicker_lab.traits.cases import scan_cases


def main(
    cases: Annotated[str, "JSON to write"],
    source: Annotated[str, "set of trees: thin, bearing, conifer, or any of scans"],
    number: Annotated[int, "of a grown tree"] = 0,
    n_points: Annotated[int, "of a grown tree's cloud"] = 100_000,
    results: Annotated[str, "results/TREE of a scan"] = "",
    truth: Annotated[str, "the truth of its scene"] = "",
) -> None:
    if results:
        found = {"cases": scan_cases(source, results, truth)}
    else:
        found = measure_grown(source, number, n_points)
    write_json(cases, found, indent=None)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
