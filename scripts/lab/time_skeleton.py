"""Measure CPU time and memory from a labelled cloud to its traits.

Reads what sample_timing_cloud.py wrote; writes JSON. Example:

    python scripts/lab/time_skeleton.py --cloud cloud.npz --times times.json
"""

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.skeletons.timing import read_timing_cloud, time_stages


def main(cloud, times):
    """Load, measure, save."""
    write_json(times, time_stages(*read_timing_cloud(cloud)))


parser = stage_parser(__doc__)
parser.add_argument("--cloud", required=True, help="NPZ from sample_timing_cloud.py")
parser.add_argument("--times", required=True, help="JSON to write")
run(main, parser, globals().get("snakemake"))
