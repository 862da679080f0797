"""Put what a run says of real scans without a truth into one table.

Reads traits.csv and the files that the stages left, also of scans that stopped on the way; prints
the table and writes it as Markdown and JSON. Example:

    python scripts/lab/report_real_photos.py --traits results/traits.csv --benchmarks benchmarks \\
        --table results/real_photos/table.md --scores results/real_photos/scores.json
"""

import csv
import logging
from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.files import write_json, write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.real_photos import markdown, scan_row


def main(traits, benchmarks, table, scores):
    """Collect, print, save."""
    results = Path(traits).parent
    with Path(traits).open(newline="") as handle:
        status = {line["tree"]: line for line in csv.DictReader(handle)}
    rows = {t: scan_row(t, results, Path(benchmarks), line) for t, line in status.items()}
    text = markdown(rows)
    logging.getLogger("cherrypicker").info("%s", text, extra={"console": True})
    write_json(scores, rows)
    write_text(table, text)


parser = stage_parser(__doc__)
parser.add_argument("--traits", required=True, help="traits.csv of a run, in its results folder")
parser.add_argument("--benchmarks", required=True, help="its folder of time and memory")
parser.add_argument("--table", required=True, help="Markdown to write")
parser.add_argument("--scores", required=True, help="JSON to write")
run(main, parser, globals().get("snakemake"))
