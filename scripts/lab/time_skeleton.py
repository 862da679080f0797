"""Measure CPU time and memory from a labelled cloud to its traits, ours and the peer's.

Reads what sample_timing_cloud.py wrote; writes JSON. Example:

    python scripts/lab/time_skeleton.py --cloud cloud.npz --times times.json
"""

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.skeletons.timing import read_timing_cloud, time_stages


def main(cloud, times, *, peer_python="", peer_iterations=0):
    """Load, measure, save."""
    points, skeleton = read_timing_cloud(cloud)
    report = time_stages(points, skeleton, peer_python=peer_python, peer_iterations=peer_iterations)
    write_json(times, report)


parser = stage_parser(__doc__)
parser.add_argument("--cloud", required=True, help="NPZ from sample_timing_cloud.py")
parser.add_argument("--times", required=True, help="JSON to write")
parser.add_argument("--peer_python", default="", help="Python that has pc-skeletor")
parser.add_argument("--peer_iterations", type=int, default=0, help="of its LBC; 0 leaves it out")
run(main, parser, globals().get("snakemake"))
