"""Undistort the registered photos into a dense workspace.

Reads the sparse model and the photos, writes COLMAP's dense workspace (images/, sparse/, stereo/)
and its manifest undistorted.json. Example:

    python scripts/undistort_photos.py --model sfm/model/images.bin --photos photos/*.jpg \
        --undistorted dense/undistorted.json
"""

from pathlib import Path

from cherrypicker.files import write_json
from cherrypicker.mvs.undistort import undistort
from cherrypicker.runner import run, stage_parser


def main(model, photos, undistorted, *, max_image_size_px: int = 1600, threads: int = 2):
    """Undistort, then write the manifest, whose folder is the workspace."""
    manifest = undistort(
        Path(model).parent, photos, Path(undistorted).parent, max_image_size_px, threads=threads
    )
    write_json(undistorted, manifest)


parser = stage_parser(__doc__)
parser.add_argument("--model", required=True, help="images.bin of the sparse model")
parser.add_argument("--photos", nargs="+", required=True, help="the photos of the tree")
parser.add_argument("--undistorted", required=True, help="manifest to write, in the workspace")
run(main, parser, globals().get("snakemake"))
