"""Turn the cloud and the poses upright: z up, ground at z = 0, centred on what the cameras look at.

Reads cloud.ply, poses.npz and the photos' EXIF orientation, writes aligned.ply, aligned_poses.npz
and align.json (transform, angles, candidate planes). Example:

    python scripts/align_cloud.py --cloud cloud.ply --poses poses.npz --photos photos/*.jpg \
        --aligned aligned.ply --aligned_poses aligned_poses.npz --report align.json
"""

from dataclasses import replace
from pathlib import Path

from cherrypicker.files import write_json
from cherrypicker.photos import exif_orientation
from cherrypicker.placement.align import align
from cherrypicker.placement.camera_geometry import turns_from_exif
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses, write_poses
from cherrypicker.runner import run, stage_parser


def main(
    cloud,
    poses,
    photos,
    aligned,
    aligned_poses,
    report,
    *,
    ground_distance_fraction,
    n_planes,
    up_from,
    seed,
):
    """Load, align, save."""
    dense, cameras = read_cloud(cloud), read_poses(poses)
    files = {Path(path).name: path for path in photos or []}
    names = [Path(str(name)).name for name in cameras.names]
    orientations = [exif_orientation(files[name]) if name in files else 1 for name in names]
    result = align(
        dense.points,
        cameras,
        stated_turns=turns_from_exif(orientations),
        ground_distance=ground_distance_fraction,
        n_planes=n_planes,
        up_from=up_from,
        seed=seed,
    )
    moved = dense.transformed(1.0, result.rotation, result.translation)
    write_cloud(aligned, replace(moved, frame="aligned", unit="arbitrary"))
    write_poses(aligned_poses, cameras.transformed(1.0, result.rotation, result.translation))
    write_json(report, result.report)


parser = stage_parser(__doc__)
parser.add_argument("--cloud", required=True, help="dense cloud, PLY, COLMAP's frame")
parser.add_argument("--poses", required=True, help="camera poses, NPZ, the same frame")
parser.add_argument("--photos", nargs="*", help="photo files, for their EXIF orientation")
parser.add_argument("--aligned", required=True, help="aligned cloud to write")
parser.add_argument("--aligned_poses", required=True, help="aligned poses to write")
parser.add_argument("--report", required=True, help="JSON of transform, angles and candidates")
parser.add_argument(
    "--ground_distance_fraction",
    type=float,
    default=0.03,
    help="largest distance of ground points from their plane, in camera distances",
)
parser.add_argument("--n_planes", type=int, default=5, help="planes tried as the ground")
parser.add_argument("--up_from", default="auto", help="auto, ground or cameras")
parser.add_argument("--seed", type=int, default=0)
run(main, parser, globals().get("snakemake"))
