"""Gather S-LBC over LBC by trunk radius into a table, and trunk_ratio.png beside them.

Example:

    python scripts/lab/report_trunk_ratio.py --table table.md --scores trunks/*/*/scores.json
"""

from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.files import write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.outputs import save
from cherrypicker_lab.skeletons.trunk_ratio import gather_trunks, ratio_figure, write_ratio_table


def main(scores, table):
    """Read all, write the table and the figure."""
    found = gather_trunks(scores)
    save(ratio_figure(found), Path(table).with_name("trunk_ratio.png"))
    write_text(table, write_ratio_table(found))


parser = stage_parser(__doc__)
parser.add_argument("--scores", required=True, nargs="+", help="of measure_trunk_ratio, JSON")
parser.add_argument("--table", required=True, help="Markdown to write; its folder takes the figure")
run(main, parser, globals().get("snakemake"))
