"""Gather the benchmark of two dates into a table.

Example:

    python scripts/lab/report_series_benchmark.py --table table.md \\
        --pairs results/benchmark/series/*/*/pairs.json
"""

import lab_path  # noqa: F401
from cherrypicker.files import read_json, write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.series.tables import write_table


def main(pairs, table):
    write_text(table, write_table([read_json(path) for path in pairs]))


parser = stage_parser(__doc__)
parser.add_argument("--pairs", required=True, nargs="+", help="of measure_series_benchmark, JSON")
parser.add_argument("--table", required=True, help="Markdown to write")
run(main, parser, globals().get("snakemake"))
