"""Undistort the registered photos into a dense workspace.

Reads the sparse model and the photos, writes COLMAP's dense workspace (images/ and sparse/ in one
folder) and the cameras of the undistorted photos. Example:

    python scripts/undistort_photos.py --model sfm/model/images.bin --photos photos/*.jpg \
        --images dense/images --sparse dense/sparse --cameras dense/poses.npz
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.mvs.undistort import undistort
from cherrypicker.mvs.workspace import workspace_of
from cherrypicker.photos import photo_files
from cherrypicker.poses import write_poses
from cherrypicker.runner import run, stage_parser


def main(
    model: Annotated[str, "images.bin of the sparse model"],
    photos: Annotated[list[str], "the photos of the tree"],
    images: Annotated[str, "folder of undistorted photos to write"],
    sparse: Annotated[str, "folder of their sparse model to write, beside it"],
    cameras: Annotated[str, "poses.npz of the undistorted photos to write"],
    *,
    max_image_size_px: int = 1600,
    threads: int = 2,
) -> None:
    workspace = workspace_of(images=images, sparse=sparse)
    poses = undistort(
        Path(model).parent, photo_files(photos), workspace, max_image_size_px, threads=threads
    )
    write_poses(cameras, poses)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
