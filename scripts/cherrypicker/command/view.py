"""Open a tree's page, or the batch's, in the browser.

The page is served as by `cherrypicker serve`, so that edits can be saved, until Ctrl-C. Examples:

    cherrypicker view
    cherrypicker view row3_tree07
"""

import argparse
from pathlib import Path

from cherrypicker.command import serve
from cherrypicker.command.work_folder import folder_parser
from cherrypicker.errors import StageError

parser = folder_parser(__doc__)
parser.add_argument(
    "tree", nargs="?", metavar="TREE", help="a finished tree; without one the batch"
)
parser.add_argument("--port", type=int, default=0, help="default one that is free")
parser.add_argument("--no-open", dest="open", action="store_false", help="print the address alone")


def main(args: argparse.Namespace) -> int:
    """Serve and open; return 0."""
    args.page = f"{args.tree}/report.html" if args.tree else "summary.html"
    if not Path("results", args.page).is_file():
        cause = "there is no such page yet; cherrypicker run makes it"
        raise StageError(cause, file=f"results/{args.page}")
    return serve.main(args)
