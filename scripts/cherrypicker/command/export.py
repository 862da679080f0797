"""Write finished trees in the formats of other tools.

Reads results/TREE, writes results/TREE/export/TREE.SUFFIX. Examples:

    cherrypicker export row3_tree07 --to treeqsm-csv
    cherrypicker export row3_tree07 row3_tree08 --to mtg gltf las
"""

import argparse
from pathlib import Path

from cherrypicker.command.work_folder import folder_parser, from_here, results_of
from cherrypicker.errors import StageError
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.formats.table import FORMATS

parser = folder_parser(__doc__)
parser.add_argument("trees", nargs="+", metavar="TREE", help="a finished tree")
parser.add_argument(
    "--to", nargs="+", required=True, choices=FORMATS, metavar="FORMAT", help=", ".join(FORMATS)
)
parser.add_argument(
    *("-o", "--output"), type=from_here, help="file to write, with one tree and one format"
)


def main(args: argparse.Namespace) -> int:
    """Write each tree in each format; return 0."""
    if args.output and len(args.trees) * len(args.to) > 1:
        raise StageError("one file for several exports", key="--output")
    suffix = Path(f"tree{FORMATS[args.to[0]].suffix}").suffix
    # A LAS file that ends in .laz is written compressed
    if args.output and args.output.suffix.lower().replace(".laz", ".las") != suffix:
        cause = f"a file of {args.to[0]} ends in {suffix}"
        raise StageError(cause, file=args.output, key="--output or --to")
    for tree in args.trees:
        measured = read_measured_tree(results_of(tree))
        for name in args.to:
            kind = FORMATS[name]
            path = args.output or measured.folder / "export" / f"{tree}{kind.suffix}"
            kind.write(path, measured)
            print(f"{path}: {kind.title}")
    return 0
