"""Scale the cloud and the poses to metres, or normalise them where there is no scale.

Reads denoised.ply, aligned_poses.npz, scale.json and crop.json, writes metric.ply,
metric_poses.npz and metric.json. Example:

    python scripts/scale_cloud.py --cloud denoised.ply --poses aligned_poses.npz \
        --scale scale.json --crop crop.json --metric metric.ply \
        --metric_poses metric_poses.npz --report metric.json
"""

from cherrypicker.files import read_json, write_json
from cherrypicker.markers.scale_scene import scale_scene
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses, write_poses
from cherrypicker.runner import run, stage_parser


def main(cloud, poses, scale, crop, metric, metric_poses, report):
    """Load, scale, save."""
    scaled, scaled_poses, details = scale_scene(
        read_cloud(cloud), read_poses(poses), read_json(scale), read_json(crop)
    )
    write_cloud(metric, scaled)
    write_poses(metric_poses, scaled_poses)
    write_json(report, details)


parser = stage_parser(__doc__)
parser.add_argument("--cloud", required=True, help="denoised cloud, PLY, aligned frame")
parser.add_argument("--poses", required=True, help="aligned poses, NPZ")
parser.add_argument("--scale", required=True, help="scale.json")
parser.add_argument("--crop", required=True, help="crop.json")
parser.add_argument("--metric", required=True, help="metric cloud to write")
parser.add_argument("--metric_poses", required=True, help="metric poses to write")
parser.add_argument("--report", required=True, help="JSON of the unit and the region to write")
run(main, parser, globals().get("snakemake"))
