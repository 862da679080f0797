"""Measure what each stage costs on one generated scene, by putting the truth in its place.

Reads results/TREE (complete) and SCENE/truth beside the photos; runs the stages after each one
replaced in working folders of their own below that of the budget; writes the errors and the costs
as JSON. See cherrypicker_lab/error_budget.py. Example:

    python scripts/lab/measure_error_budget.py --tree cherry_leader --found results/cherry_leader \\
        --row '{"photos": "resources/demo/cherry_leader/photos", "marker_sides_m": "7:0.25",
                "marker_dictionary": "DICT_4X4_50"}' \\
        --truth resources/demo/cherry_leader/truth --snakefile Snakefile \\
        --budget results/error_budget/cherry_leader/budget.json
"""

import json
from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.batch.config import resolve_config
from cherrypicker.files import load_yaml, write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.error_budget import climb

SCHEMA = Path(__file__).resolve().parents[2] / "workflow/schemas/config.schema.yaml"


def main(budget, *, tree, found, truth, row, snakefile, threads, settings=None):
    """Run the ladder, save what it says."""
    report = climb(
        Path(found),
        Path(truth),
        Path(budget).parent,
        tree=tree,
        row=row,
        settings=settings or resolve_config(load_yaml(SCHEMA), {}, source="the defaults"),
        snakefile=Path(snakefile),
        threads=threads,
    )
    write_json(budget, report)


parser = stage_parser(__doc__)
parser.add_argument("--tree", required=True, help="id of the tree")
parser.add_argument("--found", required=True, help="results/TREE")
parser.add_argument("--truth", required=True, help="SCENE/truth")
parser.add_argument("--row", type=json.loads, required=True, help="row of trees.tsv, JSON")
parser.add_argument("--settings", type=json.loads, help="the tree's config, JSON")
parser.add_argument("--snakefile", required=True, help="the workflow")
parser.add_argument("--budget", required=True, help="JSON to write; its folder takes the runs")
parser.add_argument("--threads", type=int, default=2)
run(main, parser, globals().get("snakemake"))
