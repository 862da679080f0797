"""Remove isolated points and sky silhouettes from the cropped cloud.

Reads cropped.ply, aligned_poses.npz, the sparse model (lens distortion), the photos, their sky
masks and sky_colors.npz; writes denoised.ply and denoise.json with the number of points that each
filter removed. Example:

    python scripts/denoise_cloud.py --cloud cropped.ply --poses aligned_poses.npz \\
        --cameras sfm/model/cameras.bin --photo_folder photos --masks sky \\
        --sky_colors sky_colors.npz --denoised denoised.ply --report denoise.json
"""

from pathlib import Path

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
    cloud,
    poses,
    cameras,
    photo_folder,
    masks,
    sky_colors,
    denoised,
    report,
    *,
    options: DenoiseOptions,
    looking: EvidenceOptions,
):
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


parser = stage_parser(__doc__)
parser.add_argument("--cloud", required=True, help="cropped cloud")
parser.add_argument("--poses", required=True, help="poses in the cloud's frame")
parser.add_argument("--cameras", required=True, help="cameras.bin in the folder of the model")
parser.add_argument("--photo_folder", required=True, help="folder of photos")
parser.add_argument("--masks", required=True, help="folder of sky masks")
parser.add_argument("--sky_colors", required=True, help="dominant sky colours")
parser.add_argument("--denoised", required=True, help="cloud to write")
parser.add_argument("--report", required=True, help="counts to write (JSON)")
run(main, parser, globals().get("snakemake"))
