"""Sample a tree of the paper's set to a cloud of a given size, to measure time on.

Writes the labelled cloud and the true skeleton. Example:

    python scripts/lab/sample_timing_cloud.py --n_points 300000 --cloud cloud.ply \\
        --truth skeleton.csv
"""

import lab_path  # noqa: F401
from cherrypicker.pointcloud import write_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.orchard.truth import write_skeleton
from cherrypicker_lab.skeletons.set_tree import cloud_of_size


def main(cloud, truth, *, n_points, seed=0, number=2):
    """Sample, save."""
    points, skeleton = cloud_of_size(seed, number, n_points)
    write_cloud(cloud, points)
    write_skeleton(truth, skeleton)


parser = stage_parser(__doc__)
parser.add_argument("--n_points", type=int, required=True)
parser.add_argument("--seed", type=int, default=0, help="of the set")
parser.add_argument("--number", type=int, default=2, help="of the tree in the set")
parser.add_argument("--cloud", required=True, help="PLY to write")
parser.add_argument("--truth", required=True, help="CSV of the true skeleton to write")
run(main, parser, globals().get("snakemake"))
