"""Tell how well scans repeat: two scans of one tree on one day, or of several trees.

Reads the results of each pair of scans, writes repeat.html and repeat.csv: repeatability, limits of
agreement and coefficient of variation by trait, and how many trees a trial needs. Examples:

    cherrypicker repeat tree07_morning tree07_noon
    cherrypicker repeat a1 a2 b1 b2 c1 c2 --difference 5
"""

import argparse
from pathlib import Path

from cherrypicker.accuracy.repeatability import Pair
from cherrypicker.accuracy.rescans import REPEATED, pairs_of
from cherrypicker.batch.tables import table_csv
from cherrypicker.command.work_folder import folder_parser, results_of
from cherrypicker.errors import StageError
from cherrypicker.files import write_text
from cherrypicker.report.repeat_page import COLUMNS, repeat_page, repeat_rows

parser = folder_parser(__doc__)
parser.add_argument("trees", nargs="+", metavar="SCAN", help="two finished scans a tree")
parser.add_argument(
    "--difference", type=float, default=5.0, help="that a trial shall show, percent (5)"
)
parser.add_argument("-o", "--output", default="results/repeat", help="folder to write")


def main(args: argparse.Namespace) -> int:
    """Pair the scans, write table and page; return 0."""
    if len(args.trees) % 2:
        raise StageError(f"{len(args.trees)} scans are no pairs; name two of each tree")
    if not 0 < args.difference < 100:
        raise StageError("a difference is between 0 and 100 percent", key="--difference")
    output = Path(args.output)
    scans = list(zip(args.trees[::2], args.trees[1::2], strict=True))
    told = [pairs_of(results_of(first), results_of(second)) for first, second in scans]
    joined: dict[str, list[Pair]] = {}
    for quantity in REPEATED:
        if found := [pair for each in told for pair in each.get(quantity.name, ())]:
            joined[quantity.name] = found
    share = args.difference / 100
    rows = repeat_rows(joined, share)
    kinds = {"trait": "string", "unit": "string"}
    fields = [{"name": name, "type": kinds.get(name, "number")} for name in COLUMNS]
    write_text(output / "repeat.csv", table_csv(fields, rows))
    write_text(output / "repeat.html", repeat_page(scans, joined, rows, share))
    for row in rows:
        cv = "" if row["within_cv"] is None else f"{100 * row['within_cv']:6.2f} %"
        print(f"{row['trait']:26s} {row['n_pairs']:5d} pairs, CV of a scan {cv}")
    print(output / "repeat.html")
    return 0
