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
from cherrypicker.placement.align import AlignOptions, align
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
    options: AlignOptions,
    seed: int = 0,
):
    """Load, align, save."""
    dense, cameras = read_cloud(cloud), read_poses(poses)
    files = {Path(path).name: path for path in photos or []}
    names = [Path(str(name)).name for name in cameras.names]
    orientations = [exif_orientation(files[name]) if name in files else 1 for name in names]
    result = align(
        dense.points,
        cameras,
        options,
        stated_turns=turns_from_exif(orientations),
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
run(main, parser, globals().get("snakemake"))
