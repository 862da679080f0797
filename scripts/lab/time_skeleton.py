"""Measure CPU time and memory from a labelled cloud to its traits.

Reads what sample_timing_cloud.py wrote; writes JSON. Example:

    python scripts/lab/time_skeleton.py --cloud cloud.ply --truth skeleton.csv --times times.json
"""

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.pointcloud import read_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker.skeleton import read_skeleton_csv
from cherrypicker_lab.skeletons.timing import time_stages


def main(cloud, truth, times):
    """Load, measure, save."""
    write_json(times, time_stages(read_cloud(cloud), read_skeleton_csv(truth)))


parser = stage_parser(__doc__)
parser.add_argument("--cloud", required=True, help="PLY from sample_timing_cloud.py")
parser.add_argument("--truth", required=True, help="CSV of its true skeleton")
parser.add_argument("--times", required=True, help="JSON to write")
run(main, parser, globals().get("snakemake"))
