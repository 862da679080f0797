"""Remove isolated points and sky silhouettes from the cropped cloud.

Reads cropped.ply, aligned_poses.npz, the sparse model (lens distortion), the photos, their sky
masks and sky_colors.npz; writes denoised.ply and denoise.json with the number of points that each
filter removed. Example:

    python scripts/denoise_cloud.py --cloud cropped.ply --poses aligned_poses.npz \\
        --cameras sfm/model/cameras.bin --photo_folder photos --masks sky \\
        --sky_colors sky_colors.npz --use_statistical --use_sky \\
        --denoised denoised.ply --report denoise.json
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
    use_statistical,
    n_neighbors,
    std_ratio,
    min_view_ratio,
    keep_seen_fraction,
    use_sky,
    sky_color_distance,
    same_color_distance,
    min_non_sky_fraction,
    sky_clearance,
    twig_contrast,
    depth_side,
):
    """Load cloud, poses, lenses and sky, filter, save cloud and counts."""
    options = DenoiseOptions(
        use_statistical=use_statistical,
        n_neighbors=n_neighbors,
        std_ratio=std_ratio,
        min_view_ratio=min_view_ratio,
        keep_seen_fraction=keep_seen_fraction,
        use_sky=use_sky,
        sky_color_distance=sky_color_distance,
        min_non_sky_fraction=min_non_sky_fraction,
    )
    views = read_poses(poses)
    evidence = photos_as_witnesses(
        views,
        Path(cameras).parent,
        Path(photo_folder),
        Path(masks),
        EvidenceOptions(
            depth_side_px=depth_side,
            clearance_px=sky_clearance,
            twig_contrast=twig_contrast,
            same_color_distance=same_color_distance,
        ),
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
parser.add_argument("--use_statistical", action="store_true")
parser.add_argument("--n_neighbors", type=int, default=20)
parser.add_argument("--std_ratio", type=float, default=3.0)
parser.add_argument("--min_view_ratio", type=float, default=0.4)
parser.add_argument("--keep_seen_fraction", type=float, default=0.8)
parser.add_argument("--use_sky", action="store_true")
parser.add_argument("--sky_color_distance", type=float, default=0.1)
parser.add_argument("--same_color_distance", type=float, default=0.15)
parser.add_argument("--min_non_sky_fraction", type=float, default=0.7)
parser.add_argument("--sky_clearance", type=int, default=1, help="px, at most 1.5 times depth_side")
parser.add_argument("--twig_contrast", type=float, default=0.05)
parser.add_argument(
    "--depth_side", type=int, default=1600, help="longer side of the depth maps, px"
)
run(main, parser, globals().get("snakemake"))
