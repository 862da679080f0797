"""Remove isolated points and sky silhouettes from the cropped cloud.

Reads cropped.ply, aligned_poses.npz, the sparse model (lens distortion), the sky masks and
sky_colors.npz; writes denoised.ply and denoise.json with the number of points each filter removed.
Example:

    python scripts/denoise_cloud.py --cloud cropped.ply --poses aligned_poses.npz \\
        --cameras sfm/model/cameras.bin --masks sky --sky_colors sky_colors.npz \\
        --denoised denoised.ply --report denoise.json
"""

from functools import partial
from pathlib import Path

from cherrypicker.denoise import DenoiseOptions, denoise_cloud, sky_evidence
from cherrypicker.files import write_json
from cherrypicker.lens import PhotoLenses
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker.sky.colors import read_sky_colors
from cherrypicker.sky.scan import read_mask


def main(
    cloud,
    poses,
    cameras,
    masks,
    sky_colors,
    denoised,
    report,
    *,
    use_statistical,
    n_neighbors,
    std_ratio,
    use_sky,
    sky_color_distance,
    min_non_sky_fraction,
):
    """Load cloud, poses, lenses and sky, filter, save cloud and counts."""
    options = DenoiseOptions(
        use_statistical=use_statistical,
        n_neighbors=n_neighbors,
        std_ratio=std_ratio,
        use_sky=use_sky,
        sky_color_distance=sky_color_distance,
        min_non_sky_fraction=min_non_sky_fraction,
    )
    views = read_poses(poses)
    lenses = PhotoLenses(Path(cameras).parent, views.names)
    evidence = partial(
        sky_evidence,
        poses=views,
        to_photo=lenses.to_photo,
        read_sky=lambda i: read_mask(
            Path(masks) / f"{Path(str(views.names[i])).stem}.png", lenses.shape(i)
        ),
    )
    kept, counts = denoise_cloud(read_cloud(cloud), read_sky_colors(sky_colors), evidence, options)
    write_cloud(denoised, kept)
    write_json(report, counts)


parser = stage_parser(__doc__)
parser.add_argument("--cloud", required=True, help="cropped cloud")
parser.add_argument("--poses", required=True, help="poses in the cloud's frame")
parser.add_argument("--cameras", required=True, help="cameras.bin in the folder of the model")
parser.add_argument("--masks", required=True, help="folder of sky masks")
parser.add_argument("--sky_colors", required=True, help="dominant sky colours")
parser.add_argument("--denoised", required=True, help="cloud to write")
parser.add_argument("--report", required=True, help="counts to write (JSON)")
parser.add_argument("--use_statistical", action="store_true")
parser.add_argument("--n_neighbors", type=int, default=20)
parser.add_argument("--std_ratio", type=float, default=3.0)
parser.add_argument("--use_sky", action="store_true")
parser.add_argument("--sky_color_distance", type=float, default=0.08)
parser.add_argument("--min_non_sky_fraction", type=float, default=0.5)
run(main, parser, globals().get("snakemake"))
