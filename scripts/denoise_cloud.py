"""Remove isolated points and sky silhouettes from the cropped cloud.

Reads cropped.ply, aligned_poses.npz, the sparse model (lens distortion), the photos, their sky
masks and sky_colors.npz; writes denoised.ply and denoise.json with the number of points that each
filter removed. Example:

    python scripts/denoise_cloud.py --cloud cropped.ply --poses aligned_poses.npz \\
        --cameras sfm/model/cameras.bin --photo_folder photos --masks sky \\
        --sky_colors sky_colors.npz --denoised denoised.ply --report denoise.json
"""

from pathlib import Path
from typing import Annotated

import numpy as np

from cherrypicker.denoising.denoise import GROUND_SHARE, DenoiseOptions, denoise_cloud
from cherrypicker.denoising.evidence import EvidenceOptions
from cherrypicker.denoising.witnesses import photos_as_witnesses
from cherrypicker.files import write_json
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker.sky.colors import read_sky_colors


def main(
    cloud: Annotated[str, "cropped cloud"],
    poses: Annotated[str, "poses in the cloud's frame"],
    cameras: Annotated[str, "cameras.bin in the folder of the model"],
    photo_folder: Annotated[str, "folder of photos"],
    masks: Annotated[str, "folder of sky masks"],
    sky_colors: Annotated[str, "dominant sky colours"],
    denoised: Annotated[str, "cloud to write"],
    report: Annotated[str, "counts to write (JSON)"],
    *,
    options: DenoiseOptions,
    looking: EvidenceOptions,
) -> None:
    """Load cloud, poses, lenses and sky, filter, save cloud and counts."""
    views = read_poses(poses)
    evidence = photos_as_witnesses(
        views, Path(cameras).parent, Path(photo_folder), Path(masks), looking
    )
    kept, counts = denoise_cloud(
        read_cloud(cloud),
        read_sky_colors(sky_colors),
        evidence,
        options,
        ground_height=GROUND_SHARE * float(np.median(views.centers[:, 2])),
    )
    write_cloud(denoised, kept)
    write_json(report, counts)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
