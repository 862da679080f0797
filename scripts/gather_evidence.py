"""Say of every pixel of the undistorted photos whether it shows clear sky, thin wood or a solid.

Reads the undistorted photos, the sky masks and the sparse model's cameras; writes one raster a
photo (``{stem}.png``), which all stages read that ask what the photos show. Example:

    python scripts/gather_evidence.py --images dense/images --cameras dense/poses.npz \\
        --sky_masks sky --lenses sfm/model/cameras.bin --evidence evidence
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.mvs.raster import SkyMasks, write_rasters
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser


def main(
    images: Annotated[str, "folder of the undistorted photos"],
    cameras: Annotated[str, "their poses.npz"],
    sky_masks: Annotated[str, "folder of sky masks"],
    lenses: Annotated[str, "cameras.bin of the photos as stored"],
    evidence: Annotated[str, "folder of rasters to write"],
) -> None:
    poses = read_poses(cameras)
    masks = SkyMasks(sky_masks, Path(lenses).parent)
    write_rasters(Path(images), poses, masks, Path(evidence))


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
