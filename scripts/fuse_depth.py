"""Fuse the depth maps into the dense cloud.

Reads the dense workspace (its manifest depth.json) and what each photo shows (evidence), writes
cloud.ply with colours, normals and the number of photos that saw each point, and coverage.json: for
the region that the cameras look at, in voxels, how many photos frame it, how many depth maps hold
something there, and how probable wood is there by the photos. With silhouettes, twigs that photos
show before the sky and the depth maps lack are added; the field from_silhouette is 1 for their
points. Example:

    python scripts/fuse_depth.py --depth dense/depth.json --evidence evidence \\
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
from cherrypicker.pointcloud import write_cloud
from cherrypicker.runner import run, stage_parser


def main(
    depth: Annotated[str, "manifest of the depth maps"],
    evidence: Annotated[str, "folder of what each photo shows"],
    cloud: Annotated[str, "cloud to write, PLY"],
    coverage: Annotated[str, "coverage.json to write"],
    several: Annotated[bool, "whether the scan is of several trees"] = False,
    *,
    options: FusionOptions,
    fusion: str = "star",
    silhouettes: bool = True,
    seed: int = 0,
    threads: int = 2,
) -> None:
    """Load, fuse, add twigs, save, and count what the region holds."""
    names = read_json(depth)["maps"]
    photos = ScanPhotos(Path(depth).parent, evidence, several=several)
    fused = fuse_workspace(photos, names, options, method=fusion, threads=threads)
    region = photos.region
    content: dict = {"region": None}
    if region is not None:
        content = measure_coverage(photos, region, names)
        if silhouettes:
            inside = fused.points[region.holds(fused.points)]
            words = words_of_clear_sky(photos, inside, seed=seed)
            fused = add_silhouettes(photos, fused, region, words, threads=threads)
    write_json(coverage, content, indent=None)
    write_cloud(cloud, fused)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
