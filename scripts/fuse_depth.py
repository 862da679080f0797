"""Fuse the depth maps into the dense cloud.

Reads the dense workspace (its manifest depth.json), writes cloud.ply with colours, normals and the
number of photos that saw each point. Example:

    python scripts/fuse_depth.py --depth dense/depth.json --cloud cloud.ply
"""

from pathlib import Path

from cherrypicker.files import read_json
from cherrypicker.mvs.fusion import FusionOptions, fuse_workspace
from cherrypicker.pointcloud import write_cloud
from cherrypicker.runner import run, stage_parser


def main(depth, cloud, *, method, threads, **options):
    """Load, fuse, save."""
    names = read_json(depth)["maps"]
    fused = fuse_workspace(
        Path(depth).parent, names, FusionOptions(**options), method=method, threads=threads
    )
    write_cloud(cloud, fused)


defaults = FusionOptions()
parser = stage_parser(__doc__)
parser.add_argument("--depth", required=True, help="manifest of the depth maps")
parser.add_argument("--cloud", required=True, help="cloud to write, PLY")
parser.add_argument("--method", default="star", help="star (ours) or colmap")
parser.add_argument("--min_views", type=int, default=defaults.min_views)
parser.add_argument("--n_check", type=int, default=defaults.n_check)
parser.add_argument("--max_reproj_error_px", type=float, default=defaults.max_reproj_error_px)
parser.add_argument("--max_depth_error", type=float, default=defaults.max_depth_error)
parser.add_argument("--max_normal_error_deg", type=float, default=defaults.max_normal_error_deg)
parser.add_argument("--threads", type=int, default=2)
run(main, parser, globals().get("snakemake"))
