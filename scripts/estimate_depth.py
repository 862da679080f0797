"""Estimate depth and normal maps of the undistorted photos.

Reads the dense workspace (images/ and sparse/ in one folder), writes photometric and geometric maps
in COLMAP's layout beside them, the depths alone as a small raster a photo, and depth.json: which
photos have maps. What a killed run left of the maps, in .stereo there, is taken up. Example:

    python scripts/estimate_depth.py --images dense/images --sparse dense/sparse \\
        --maps dense/stereo --depth depth --report dense/depth.json
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.files import write_json
from cherrypicker.mvs.backends.choice import estimate_apart
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.workspace import workspace_of
from cherrypicker.runner import run, stage_parser


def main(
    images: Annotated[str, "folder of the undistorted photos"],
    sparse: Annotated[str, "folder of their sparse model"],
    maps: Annotated[str, "folder of the maps to write, beside it"],
    depth: Annotated[str, "folder of the depths to write"],
    report: Annotated[str, "JSON to write: which photos have maps"],
    evidence: Annotated[str | None, "folder of what each photo shows, to leave out sky"] = None,
    several: Annotated[bool, "whether the scan is of several trees"] = False,
    *,
    options: StereoOptions,
    backend: str = "auto",
    threads: int = 2,
) -> None:
    content = estimate_apart(
        workspace_of(images=images, sparse=sparse, stereo=maps),
        options,
        several=several,
        backend=backend,
        threads=threads,
        evidence=Path(evidence) if evidence else None,
        depth=Path(depth),
    )
    write_json(report, content)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
