"""Compare results with reference measures of real trees, in the table of the traits benchmark.

Reads the results folders of the trees (traits.json; for branches also branches.csv and
skeleton.graphml), whose names are the trees'. References: a CSV of tape measures (name, trait,
value, unit), a folder with a skeleton {name}.csv (id, parent, x, y, z, radius; metres, in the
frame of the results), or both. Prints the table and writes it as Markdown. Example:

    python scripts/lab/compare_reference_traits.py --results results/tree_1 results/tree_2 \\
        --measures tape.csv --skeletons reference_skeletons --table table.md
"""

import logging
from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.files import write_json, write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.traits.pairs import NEAR_BASE_M, NEAR_M
from cherrypicker_lab.traits.references import compare_results, read_reference_table
from cherrypicker_lab.traits.tables import write_table

logger = logging.getLogger(__name__)


def main(results, table, *, measures=None, skeletons=None, pairs=None, near_m, base_m):
    measured = read_reference_table(measures) if measures else {}
    reports = []
    for folder in map(Path, results):
        skeleton = Path(skeletons) / f"{folder.name}.csv" if skeletons else None
        reports.append(
            compare_results(
                folder,
                measured.get(folder.name),
                skeleton if skeleton and skeleton.is_file() else None,
                near_m=near_m,
                base_m=base_m,
            )
        )
    text = write_table(reports)
    logger.info("%s", text)
    write_text(table, text)
    if pairs:
        write_json(pairs, {"trees": reports})


parser = stage_parser(__doc__)
parser.add_argument("--results", required=True, nargs="+", help="results folders of trees")
parser.add_argument("--measures", help="CSV of name, trait, value, unit")
parser.add_argument("--skeletons", help="folder of reference skeletons")
parser.add_argument("--near_m", type=float, default=NEAR_M, help="how near a branch runs, m")
parser.add_argument("--base_m", type=float, default=NEAR_BASE_M, help="how near it starts, m")
parser.add_argument("--pairs", help="JSON of all values to write")
parser.add_argument("--table", required=True, help="Markdown to write")
run(main, parser, globals().get("snakemake"))
