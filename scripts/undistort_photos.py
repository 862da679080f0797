"""Undistort the registered photos into a dense workspace.

Reads the sparse model and the photos, writes COLMAP's dense workspace (images/, sparse/, stereo/)
and its manifest undistorted.json. Example:

    python scripts/undistort_photos.py --model sfm/model/images.bin --photos photos/*.jpg \
        --undistorted dense/undistorted.json
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.files import write_json
from cherrypicker.mvs.undistort import undistort
from cherrypicker.photos import photo_files
from cherrypicker.runner import run, stage_parser


def main(
    model: Annotated[str, "images.bin of the sparse model"],
    photos: Annotated[list[str], "the photos of the tree"],
    undistorted: Annotated[str, "manifest to write, in the workspace"],
    *,
    max_image_size_px: int = 1600,
    threads: int = 2,
) -> None:
    """Undistort, then write the manifest, whose folder is the workspace."""
    manifest = undistort(
        Path(model).parent,
        photo_files(photos),
        Path(undistorted).parent,
        max_image_size_px,
        threads=threads,
    )
    write_json(undistorted, manifest)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
