"""Remove isolated points and sky silhouettes from the cropped cloud.

Reads cropped.ply, aligned_poses.npz, the undistorted photos' cameras, what each photo shows
(evidence) and sky_colors.npz; writes denoised.ply, denoise.json with the number of points that
each filter removed, and denoise.npz: ``removed_by`` a point of cropped.ply. Example:

    python scripts/denoise_cloud.py --cloud cropped.ply --poses aligned_poses.npz \\
        --cameras dense/poses.npz --evidence evidence \\
        --sky_colors sky_colors.npz --denoised denoised.ply --report denoise.json \\
        --removed denoise.npz
"""

from functools import partial
from typing import Annotated

import numpy as np

from cherrypicker.denoising.denoise import GROUND_SHARE, DenoiseOptions, denoise_cloud
from cherrypicker.evidence.existence import ask_points
from cherrypicker.files import write_json, write_npz
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker.sky.colors import read_sky_colors


def main(
    cloud: Annotated[str, "cropped cloud"],
    poses: Annotated[str, "poses in the cloud's frame"],
    cameras: Annotated[str, "poses.npz of the undistorted photos"],
    evidence: Annotated[str, "folder of what each photo shows"],
    sky_colors: Annotated[str, "dominant sky colours"],
    denoised: Annotated[str, "cloud to write"],
    report: Annotated[str, "counts to write (JSON)"],
    removed: Annotated[str, "what took out each point, NPZ to write"],
    *,
    options: DenoiseOptions,
    seed: int = 0,
) -> None:
    views = read_poses(poses)
    photos = ScanPhotos(read_poses(cameras), evidence, views)
    kept, counts, by = denoise_cloud(
        read_cloud(cloud),
        read_sky_colors(sky_colors),
        partial(ask_points, photos, seed=seed),
        options,
        ground_height=GROUND_SHARE * float(np.median(views.centers[:, 2])),
    )
    write_cloud(denoised, kept)
    write_npz(removed, removed_by=by)
    write_json(report, counts)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
