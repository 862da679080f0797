"""Compare two results folders file by file, byte for byte: what a refactoring has to leave alone.

Prints the files that differ and those that only one folder holds; exits with 1 if there are any.
Example, with the results of the demo before and after a change:

    python scripts/lab/compare_outputs.py before/results after/results --ignore '*.html'
"""

import lab_path  # noqa: F401
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.outputs import compare_folders


def main(before, after, *, ignore):
    comparison = compare_folders(before, after, ignore)
    print(comparison.describe())
    if not comparison.is_equal:
        raise SystemExit(1)


parser = stage_parser(__doc__)
parser.add_argument("before", help="results folder")
parser.add_argument("after", help="results folder")
parser.add_argument("--ignore", nargs="*", default=[], help="patterns of paths to pass over")

run(main, parser, globals().get("snakemake"))
