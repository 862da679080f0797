"""Fuse the depth maps into the dense cloud.

Reads the dense workspace (images/, sparse/ and stereo/ in one folder), depth.json, the depths of
each photo and what it shows (evidence), writes
cloud.ply with colours, normals and the number of photos that saw each point, and coverage.json: for
the region that the cameras look at, in voxels, how many photos frame it, how many depth maps hold
something there, and how probable wood is there by the photos. With silhouettes, twigs that photos
show before the sky and the depth maps lack are added; the field from_silhouette is 1 for their
points. Example:

    python scripts/fuse_depth.py --images dense/images --sparse dense/sparse --maps dense/stereo \\
        --report dense/depth.json --cameras dense/poses.npz --depth depth --evidence evidence \\
        --cloud cloud.ply --coverage dense/coverage.json
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.evidence.coverage import measure_coverage
from cherrypicker.evidence.existence import words_of_clear_sky
from cherrypicker.files import read_json, write_json
from cherrypicker.mvs.fusion import FusionOptions, fuse_workspace
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.mvs.silhouettes import add_silhouettes
from cherrypicker.mvs.workspace import Workspace, workspace_of
from cherrypicker.photos import read_photo
from cherrypicker.placement.bare_ground import needed_points
from cherrypicker.pointcloud import write_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser


def main(
    images: Annotated[str, "folder of the undistorted photos"],
    sparse: Annotated[str, "folder of their sparse model"],
    maps: Annotated[str, "folder of their depth and normal maps"],
    report: Annotated[str, "depth.json: which photos have maps"],
    cameras: Annotated[str, "poses.npz of the undistorted photos"],
    depth: Annotated[str, "folder of the depths of each photo"],
    evidence: Annotated[str, "folder of what each photo shows"],
    cloud: Annotated[str, "cloud to write, PLY"],
    coverage: Annotated[str, "coverage.json to write"],
    several: Annotated[bool, "whether the scan is of several trees"] = False,
    *,
    options: FusionOptions,
    fusion: str = "star",
    silhouettes: bool = True,
    ground_spacing: float = 0.005,
    margin_fraction: float = 0.0,
    seed: int = 0,
    threads: int = 2,
) -> None:
    workspace = Workspace(workspace_of(images=images, sparse=sparse, stereo=maps), several=several)
    names = read_json(report)["maps"]
    fused = fuse_workspace(workspace, names, options, method=fusion, threads=threads)
    photos = ScanPhotos(
        read_poses(cameras),
        evidence,
        depth=depth,
        read_photo=lambda name, longest_px: read_photo(Path(images) / name),
    )
    region = workspace.region
    content: dict = {"region": None}
    if region is not None:
        content = measure_coverage(photos, region)
        if silhouettes:
            inside = fused.points[region.holds(fused.points)]
            words = words_of_clear_sky(photos, inside, seed=seed)
            fused = add_silhouettes(photos, fused, region, words, threads=threads)
        if ground_spacing:
            kept = needed_points(
                fused.points,
                workspace.poses,
                region,
                ground_spacing,
                margin_fraction=None if several else margin_fraction,
                seed=seed,
            )
            fused = fused.select(kept)
    write_json(coverage, content, indent=None)
    write_cloud(cloud, fused)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
