"""Gather the benchmark of traits into a table and a figure of found against true values.

Reads pairs.json files; writes Markdown and PNG. Example:

    python scripts/lab/report_traits_benchmark.py --pairs results/benchmark/traits/*/pairs.json \\
        --table table.md --figure traits.png
"""

import lab_path  # noqa: F401
from cherrypicker.files import read_json, write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.outputs import save
from cherrypicker_lab.traits.tables import traits_figure, write_table


def main(pairs, table, figure):
    reports = [read_json(path) for path in pairs]
    save(traits_figure(reports), figure)
    write_text(table, write_table(reports))


parser = stage_parser(__doc__)
parser.add_argument("--pairs", required=True, nargs="+", help="pairs of trees, JSON")
parser.add_argument("--table", required=True, help="Markdown to write")
parser.add_argument("--figure", required=True, help="PNG to write")
run(main, parser, globals().get("snakemake"))
