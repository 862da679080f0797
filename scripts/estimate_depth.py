"""Estimate depth and normal maps of the undistorted photos.

Reads the dense workspace (its manifest undistorted.json), writes photometric and geometric maps in
COLMAP's layout and the manifest depth.json. Whole maps of the same settings are kept. Example:

    python scripts/estimate_depth.py --undistorted dense/undistorted.json --depth dense/depth.json
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.files import read_json, write_json
from cherrypicker.mvs.backends.choice import estimate_workspace
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.runner import run, stage_parser


def main(
    undistorted: Annotated[str, "manifest of the dense workspace"],
    depth: Annotated[str, "manifest of the depth maps to write"],
    cameras: Annotated[str | None, "cameras.bin of the photos as stored, for the sky masks"] = None,
    sky_masks: Annotated[str | None, "folder of sky masks; what they cover is left out"] = None,
    several: Annotated[bool, "whether the scan is of several trees"] = False,
    *,
    options: StereoOptions,
    backend: str = "auto",
    use_sky_masks: bool = True,
    threads: int = 2,
) -> None:
    """Estimate the maps, then write the manifest."""
    masks = None
    if sky_masks and cameras:
        names = [photo["name"] for photo in read_json(undistorted)["photos"]]
        masks = SkyMasks(sky_masks, Path(cameras).parent, names, with_sky=use_sky_masks)
    manifest = estimate_workspace(
        Path(undistorted).parent,
        options,
        several=several,
        backend=backend,
        threads=threads,
        sky_masks=masks,
    )
    write_json(depth, manifest)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
