"""Sample a tree of the paper's set to a cloud of a given size, to measure time on.

Writes points, labels and the true skeleton as NPZ. Example:

    python scripts/lab/sample_timing_cloud.py --n_points 300000 --cloud cloud.npz
"""

import lab_path  # noqa: F401
from cherrypicker.files import atomic_path
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.skeletons.set_tree import cloud_of_size
from cherrypicker_lab.skeletons.timing import write_timing_cloud


def main(cloud, *, n_points, seed=0, number=2):
    """Sample, save."""
    points, truth = cloud_of_size(seed, number, n_points)
    with atomic_path(cloud) as partial, open(partial, "wb") as stream:
        write_timing_cloud(stream, points, truth.skeleton)


parser = stage_parser(__doc__)
parser.add_argument("--n_points", type=int, required=True)
parser.add_argument("--seed", type=int, default=0, help="of the set")
parser.add_argument("--number", type=int, default=2, help="of the tree in the set")
parser.add_argument("--cloud", required=True, help="NPZ to write")
run(main, parser, globals().get("snakemake"))
