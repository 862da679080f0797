"""Open a tree's page, or the batch's, in the browser.

The page is served as by `cherrypicker serve`, so that edits can be saved, until Ctrl-C. Examples:

    cherrypicker view
    cherrypicker view row3_tree07
"""

import argparse
from pathlib import Path

from cherrypicker.command.serve import serve
from cherrypicker.command.work_folder import folder_parser
from cherrypicker.errors import StageError

parser = folder_parser(__doc__)
parser.add_argument(
    "tree", nargs="?", metavar="TREE", help="a finished tree; without one the batch"
)
parser.add_argument("--port", type=int, default=0, help="default one that is free")
parser.add_argument("--no-open", action="store_true", help="print the address alone")


def main(args: argparse.Namespace) -> int:
    """Serve and open; return 0."""
    page = f"{args.tree}/report.html" if args.tree else "summary.html"
    if not Path("results", page).is_file():
        raise StageError(
            "there is no such page yet; cherrypicker run makes it", file=f"results/{page}"
        )
    serve(page, args.port, is_opened=not args.no_open)
    return 0
