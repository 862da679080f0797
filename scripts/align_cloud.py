"""Turn the cloud and the poses upright: z up, ground at z = 0, centred on what the cameras look at.

Reads cloud.ply, poses.npz and of the photos' headers their orientation and gravity, writes
aligned.ply, aligned_poses.npz and align.json (transform, angles, candidate planes). Example:

    python scripts/align_cloud.py --cloud cloud.ply --poses poses.npz --photos photos/*.jpg \
        --aligned aligned.ply --aligned_poses aligned_poses.npz --report align.json
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cherrypicker.files import write_json
from cherrypicker.intake.gravity import stated_up
from cherrypicker.photos import exif_orientation, photo_files
from cherrypicker.placement.align import align
from cherrypicker.placement.ground import AlignOptions
from cherrypicker.placement.up import turns_from_exif
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses, write_poses
from cherrypicker.runner import run, stage_parser


def main(
    cloud: Annotated[str, "dense cloud, PLY, COLMAP's frame"],
    poses: Annotated[str, "camera poses, NPZ, the same frame"],
    aligned: Annotated[str, "aligned cloud to write"],
    aligned_poses: Annotated[str, "aligned poses to write"],
    report: Annotated[str, "JSON of transform, angles and candidates"],
    photos: Annotated[Sequence[str], "photo files, for their orientation and gravity"] = (),
    *,
    options: AlignOptions,
    seed: int = 0,
) -> None:
    dense, cameras = read_cloud(cloud), read_poses(poses)
    files = {path.name: path for path in photo_files(photos or [])}
    names = [Path(str(name)).name for name in cameras.names]
    orientations = [exif_orientation(files[name]) if name in files else 1 for name in names]
    ups = [stated_up(files[name]) if name in files else None for name in names]
    result = align(
        dense.points,
        cameras,
        options,
        stated_turns=turns_from_exif(orientations),
        stated_ups=ups,
        seed=seed,
    )
    moved = dense.transformed(1.0, result.rotation, result.translation)
    write_cloud(aligned, replace(moved, frame="aligned", unit="arbitrary"))
    write_poses(aligned_poses, cameras.transformed(1.0, result.rotation, result.translation))
    write_json(report, result.report)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
