"""Fuse the depth maps into the dense cloud.

Reads the dense workspace (its manifest depth.json), writes cloud.ply with colours, normals and the
number of photos that saw each point, and coverage.json: for the region that the cameras look at, in
voxels, how many photos frame it, how many depth maps hold something there, and what the sky masks
show. With silhouettes, twigs that photos show before the sky and the depth maps lack are added; the
field from_silhouette is 1 for their points. Example:

    python scripts/fuse_depth.py --depth dense/depth.json --sky_masks sky \\
        --cameras sfm/model/cameras.bin --cloud cloud.ply --coverage dense/coverage.json
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.files import read_json, write_json
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.coverage import measure_coverage
from cherrypicker.mvs.fusion import FusionOptions, fuse_workspace
from cherrypicker.mvs.silhouettes import add_silhouettes
from cherrypicker.mvs.workspace import Workspace
from cherrypicker.pointcloud import write_cloud
from cherrypicker.runner import run, stage_parser


def main(
    depth: Annotated[str, "manifest of the depth maps"],
    sky_masks: Annotated[str, "folder of sky masks"],
    cameras: Annotated[str, "cameras.bin of the photos as stored"],
    cloud: Annotated[str, "cloud to write, PLY"],
    coverage: Annotated[str, "coverage.json to write"],
    several: Annotated[bool, "whether the scan is of several trees"] = False,
    *,
    options: FusionOptions,
    fusion: str = "star",
    silhouettes: bool = True,
    threads: int = 2,
) -> None:
    """Load, fuse, add twigs, save, and count what the region holds."""
    names = read_json(depth)["maps"]
    workspace = Workspace(Path(depth).parent, several=several)
    fused = fuse_workspace(workspace, names, options, method=fusion, threads=threads)
    region = workspace.region
    content: dict = {"region": None}
    if region is not None:
        masks = SkyMasks(sky_masks, Path(cameras).parent, workspace.poses.names)
        content = measure_coverage(workspace, region, names, masks)
        if silhouettes:
            fused = add_silhouettes(workspace, fused, region, masks, threads=threads)
    write_json(coverage, content, indent=None)
    write_cloud(cloud, fused)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
