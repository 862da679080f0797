"""Say of every pixel of the undistorted photos whether it shows clear sky, thin wood or a solid.

Reads the undistorted photos, the sky masks and the sparse model's cameras; writes one raster a
photo (``{stem}.png``), which all stages read that ask what the photos show. Example:

    python scripts/gather_evidence.py --undistorted dense/undistorted.json --sky_masks sky \\
        --cameras sfm/model/cameras.bin --evidence evidence
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.raster import write_rasters
from cherrypicker.mvs.workspace import Workspace
from cherrypicker.runner import run, stage_parser


def main(
    undistorted: Annotated[str, "manifest beside the undistorted photos"],
    sky_masks: Annotated[str, "folder of sky masks"],
    cameras: Annotated[str, "cameras.bin of the photos as stored"],
    evidence: Annotated[str, "folder of rasters to write"],
) -> None:
    """Load, look, save."""
    workspace = Workspace(Path(undistorted).parent)
    masks = SkyMasks(sky_masks, Path(cameras).parent, workspace.poses.names)
    write_rasters(workspace, masks, Path(evidence))


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
