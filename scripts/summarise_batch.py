"""Write the table and the page over all trees of the batch.

Reads every tree's traits.json below the results folder and the failures below the logs folder,
writes traits.csv and summary.html. Example:

    python scripts/summarise_batch.py --trees cherry_1 cherry_2 --table results/traits.csv \\
        --page results/summary.html
"""

from cherrypicker.batch.summary import summarise
from cherrypicker.errors import StageError
from cherrypicker.runner import run, stage_parser


def main(trees, table, page, *, dates=(), series=(), results="results", logs="logs"):
    dates, series = dates or [""] * len(trees), series or [""] * len(trees)
    if not len(trees) == len(dates) == len(series):
        raise StageError(f"{len(trees)} trees, {len(dates)} dates and {len(series)} series given")
    rows = [
        {"tree": tree, "date": date, "series": name}
        for tree, date, name in zip(trees, dates, series, strict=True)
    ]
    summarise(rows, results, logs, table, page)


parser = stage_parser(__doc__)
parser.add_argument("--trees", nargs="+", required=True, help="ids of the trees")
parser.add_argument("--dates", nargs="*", default=[], help="ISO date of each tree's scan")
parser.add_argument("--series", nargs="*", default=[], help="series of each tree's scan")
parser.add_argument("--results", default="results", help="folder of the results")
parser.add_argument("--logs", default="logs", help="folder of the logs")
parser.add_argument("--table", required=True, help="CSV to write")
parser.add_argument("--page", required=True, help="HTML to write")
run(main, parser, globals().get("snakemake"))
