"""Crop the aligned cloud to the region of interest, the place that the cameras look at.

Reads aligned.ply and aligned_poses.npz, writes cropped.ply and crop.json. Example:

    python scripts/crop_roi.py --cloud aligned.ply --poses aligned_poses.npz \
        --cropped cropped.ply --report crop.json
"""

from cherrypicker.files import write_json
from cherrypicker.placement.crop import crop_roi
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser


def main(cloud, poses, cropped, report, *, margin_fraction: float = 0.0, seed: int = 0):
    """Load, crop, save."""
    aligned = read_cloud(cloud)
    result = crop_roi(aligned.points, read_poses(poses), margin_fraction=margin_fraction, seed=seed)
    write_cloud(cropped, aligned.select(result.keep))
    write_json(report, result.report)


parser = stage_parser(__doc__)
parser.add_argument("--cloud", required=True, help="aligned cloud, PLY")
parser.add_argument("--poses", required=True, help="aligned poses, NPZ")
parser.add_argument("--cropped", required=True, help="cropped cloud to write")
parser.add_argument("--report", required=True, help="JSON of the region and counts to write")
run(main, parser, globals().get("snakemake"))
