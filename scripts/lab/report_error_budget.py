"""Put the error budgets of several scenes into one table.

Reads what measure_error_budget.py wrote, prints the tables and writes them as Markdown. Example:

    python scripts/lab/report_error_budget.py --budgets results/error_budget/*/budget.json \\
        --table results/error_budget/table.md
"""

import logging
from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.files import read_json, write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.error_budget import markdown


def main(budgets, table):
    """Load, join, print, save."""
    text = markdown({Path(path).parent.name: read_json(path) for path in budgets})
    logging.getLogger("cherrypicker").info("%s", text, extra={"console": True})
    write_text(table, text)


parser = stage_parser(__doc__)
parser.add_argument("--budgets", nargs="+", required=True, help="budget.json of each scene")
parser.add_argument("--table", required=True, help="Markdown to write")
run(main, parser, globals().get("snakemake"))
