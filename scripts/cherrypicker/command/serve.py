"""Serve the pages of a work folder on this machine, so that edits are saved by clicking.

A tree's page lies at /TREE/report.html, the batch's at /summary.html. Edits are written to the
file that graph.edits names, config/edits/TREE.yaml; the next run applies them. No other machine
can reach the pages. Examples:

    cherrypicker serve
    cherrypicker serve -d WORK --port 8080
"""

import argparse
import webbrowser

from cherrypicker.command.server import make_server
from cherrypicker.command.work_folder import batch_here, folder_parser

PORT = 8321

parser = folder_parser(__doc__)
parser.add_argument(
    "--port", type=int, default=PORT, help=f"default {PORT}; 0 takes one that is free"
)
parser.add_argument("--open", action="store_true", help="open the batch's page in the browser")
parser.set_defaults(page="summary.html")


def main(args: argparse.Namespace) -> int:
    """Serve until interrupted; return 0."""
    with make_server(batch_here(), args.port) as server:
        address = f"http://127.0.0.1:{server.server_port}/{args.page}"
        print(f"{address}\nCtrl-C ends it", flush=True)
        if args.open:
            webbrowser.open(address)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()
    return 0
