"""Make hand measurements of a tree that was digitised node by node.

Brings it onto the finished tree's skeleton and prints a row a limb's diameter, length and angle for
the table of hand measurements; --append adds them to it. Examples:

    cherrypicker measures tree07.csv --tree row3_tree07 --unit mm
    cherrypicker measures tree07.mtg --tree row3_tree07 --unit cm --diameter_unit mm --append
"""

import argparse
import sys

from cherrypicker.accuracy.digitised import limb_measures, read_digitised, register
from cherrypicker.accuracy.measures import CONFIG_KEY, append_measures, measures_csv
from cherrypicker.accuracy.places import Places
from cherrypicker.command.work_folder import batch_here, folder_parser, from_here, results_of
from cherrypicker.errors import StageError
from cherrypicker.files import read_json
from cherrypicker.skeleton import axes, read_skeleton

parser = folder_parser(__doc__)
parser.add_argument(
    "file", type=from_here, metavar="FILE", help="CSV (id, parent, x, y, z, diameter) or .mtg"
)
parser.add_argument("--tree", required=True, help="the finished tree that it is of")
parser.add_argument("--unit", default="m", help="of the file: m, cm, mm, ft, in, or metres (m)")
parser.add_argument("--diameter_unit", help="of its diameters, where that is another")
parser.add_argument("--who", default="", help="who digitised it")
parser.add_argument("--append", action="store_true", help="to the table of hand measurements")


def main(args: argparse.Namespace) -> int:
    """Print or append the rows; return 0."""
    folder = results_of(args.tree)
    ours, traits = read_skeleton(folder / "skeleton.graphml"), read_json(folder / "traits.json")
    if ours.unit != "m":
        raise StageError(f"tree {args.tree}: the scan has no scale", file=folder, key="scale")
    theirs = read_digitised(args.file, args.unit, args.diameter_unit)
    theirs, share, residual = register(args.tree, theirs, ours)
    places = Places(ours, axes(ours), traits["foot"][2])
    rows, n_left_out = limb_measures(args.tree, theirs, places, args.who)
    told = f"{share:.0%} of its length within 5 cm of our skeleton"
    told += f", median {1000 * residual:.1f} mm; {n_left_out} branches left out, of another order"
    print(told, file=sys.stderr)
    if not args.append:
        print(measures_csv(rows), end="")
        return 0
    table = batch_here().settings[CONFIG_KEY]
    if not table:
        raise StageError("no table of hand measurements is named", key=CONFIG_KEY)
    append_measures(table, rows)
    print(f"{len(rows)} rows more in {table}")
    return 0
