"""Scale the cloud and the poses to metres, or normalise them where there is no scale.

Reads denoised.ply, aligned_poses.npz, scale.json and crop.json, writes metric.ply,
metric_poses.npz and metric.json. Example:

    python scripts/scale_cloud.py --cloud denoised.ply --poses aligned_poses.npz \
        --scale scale.json --crop crop.json --metric metric.ply \
        --metric_poses metric_poses.npz --report metric.json
"""

from typing import Annotated

from cherrypicker.files import read_json, write_json
from cherrypicker.intake.clouds import HeightOptions, check_height
from cherrypicker.markers.scale_scene import scale_scene
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses, write_poses
from cherrypicker.runner import run, stage_parser


def main(
    cloud: Annotated[str, "denoised cloud, PLY, aligned frame"],
    poses: Annotated[str, "aligned poses, NPZ"],
    scale: Annotated[str, "scale.json"],
    crop: Annotated[str, "crop.json"],
    metric: Annotated[str, "metric cloud to write"],
    metric_poses: Annotated[str, "metric poses to write"],
    report: Annotated[str, "JSON of the unit and the region to write"],
    *,
    heights: HeightOptions,
) -> None:
    scaled, scaled_poses, details = scale_scene(
        read_cloud(cloud), read_poses(poses), read_json(scale), read_json(crop)
    )
    check_height(scaled, heights, "the scale (trees.tsv, scale.references)", cloud)
    write_cloud(metric, scaled)
    write_poses(metric_poses, scaled_poses)
    write_json(report, details)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
