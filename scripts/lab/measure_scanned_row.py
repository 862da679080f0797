"""Measure the workflow's results of a rendered row of trees: whose wood is whose, trunks, heights.

The row is rendered by ``render_scene.py --row SEED``, run with ``crop.target_xy: all``
(docs/lab/rows.md), and held against its truth. Example:

    python scripts/lab/measure_scanned_row.py --results results --scan row_53 \\
        --truth /data/orchard/row_53/truth --output row_53.json
"""

import logging
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.traits.rows import measure_scanned_row

logger = logging.getLogger("cherrypicker")


def main(
    results: Annotated[str, "the batch's results, finished"],
    scan: Annotated[str, "name of the scan"],
    truth: Annotated[str, "truth of the row"],
    output: Annotated[str, "JSON to write"],
) -> None:
    """Measure, save, say what was found."""
    report = measure_scanned_row(results, scan, truth)
    write_json(output, report)
    for row in report["trees"]:
        logger.info(", ".join(f"{name} {value:.4g}" for name, value in row.items()))
    logger.info("%s", report["totals"])


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
