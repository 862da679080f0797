"""Crop the aligned cloud to the region of interest, the place that the cameras look at.

Reads aligned.ply and aligned_poses.npz, writes cropped.ply and crop.json. Example:

    python scripts/crop_roi.py --cloud aligned.ply --poses aligned_poses.npz \
        --cropped cropped.ply --report crop.json
"""

from typing import Annotated

from cherrypicker.files import write_json
from cherrypicker.placement.crop import crop_roi
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser


def main(
    cloud: Annotated[str, "aligned cloud, PLY"],
    poses: Annotated[str, "aligned poses, NPZ"],
    cropped: Annotated[str, "cropped cloud to write"],
    report: Annotated[str, "JSON of the region and counts to write"],
    several: Annotated[bool, "whether the scan is of several trees"] = False,
    *,
    region: str = "view",
    margin_fraction: float = 0.0,
    seed: int = 0,
) -> None:
    aligned = read_cloud(cloud)
    keep, content = crop_roi(
        aligned.points,
        read_poses(poses),
        several=several,
        region=region,
        margin_fraction=margin_fraction,
        seed=seed,
    )
    write_cloud(cropped, aligned.select(keep))
    write_json(report, content)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
