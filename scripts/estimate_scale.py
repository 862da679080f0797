"""Find the scale of the reconstruction from markers and other known lengths, or take it as given.

Reads the photos and the sparse model, and where a trunk was taped denoised.ply; writes scale.json.
Example:

    python scripts/estimate_scale.py --photos photos/*.jpg --cameras sfm/model/cameras.bin \
        --dictionary DICT_4X4_50 --sides_m 7:0.20 --scale scale.json \
        --references '{kind: distance, markers: [7, 8], length_m: 1.0}'
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cherrypicker.files import write_json
from cherrypicker.lens import read_model
from cherrypicker.markers.estimate_scale import estimate_scale
from cherrypicker.photos import photo_files
from cherrypicker.pointcloud import read_cloud
from cherrypicker.runner import run, stage_parser


def main(
    cameras: Annotated[str, "cameras.bin of the sparse model's folder"],
    scale: Annotated[str, "scale.json to write"],
    photos: Annotated[Sequence[str], "photo files"] = (),
    cloud: Annotated[str | None, "denoised.ply, for a taped trunk"] = None,
    cell: Annotated[str, "marker, none, or metres per unit; wins over mode"] = "",
    dictionary: Annotated[str, "OpenCV's name of the marker dictionary"] = "",
    sides_m: Annotated[str, "id:side pairs in metres, 7:0.20,8:0.15"] = "",
    *,
    mode: str = "marker",
    min_images: int = 2,
    side: str = "square",
    references: Sequence[str] = (),
    threads: int = 2,
    seed: int = 0,
) -> None:
    report = estimate_scale(
        photo_files(photos or []),
        read_model(Path(cameras).parent),
        cell=cell,
        mode=mode,
        dictionary=dictionary,
        sides_m=sides_m,
        min_images=min_images,
        side=side,
        references=references or [],
        cloud=read_cloud(cloud).points if cloud else None,
        threads=threads,
        seed=seed,
    )
    write_json(scale, report)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
