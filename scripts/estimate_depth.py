"""Estimate depth and normal maps of the undistorted photos.

Reads the dense workspace (its manifest undistorted.json), writes photometric and geometric maps in
COLMAP's layout and the manifest depth.json. Whole maps of the same settings are kept. Example:

    python scripts/estimate_depth.py --undistorted dense/undistorted.json --depth dense/depth.json
"""

from pathlib import Path

from cherrypicker.files import read_json, write_json
from cherrypicker.mvs.backends.choice import estimate_workspace
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.runner import run, stage_parser


def main(
    undistorted,
    depth,
    cameras=None,
    sky_masks=None,
    *,
    options: StereoOptions,
    backend: str = "auto",
    threads: int = 2,
):
    """Estimate the maps, then write the manifest."""
    masks = None
    if sky_masks:
        names = [photo["name"] for photo in read_json(undistorted)["photos"]]
        masks = SkyMasks(sky_masks, Path(cameras).parent, names)
    manifest = estimate_workspace(
        Path(undistorted).parent,
        options,
        backend=backend,
        threads=threads,
        sky_masks=masks,
    )
    write_json(depth, manifest)


parser = stage_parser(__doc__)
parser.add_argument("--undistorted", required=True, help="manifest of the dense workspace")
parser.add_argument("--depth", required=True, help="manifest of the depth maps to write")
parser.add_argument("--sky_masks", help="folder of sky masks; what they cover is left out")
parser.add_argument("--cameras", help="cameras.bin of the photos as stored, for the sky masks")
run(main, parser, globals().get("snakemake"))
