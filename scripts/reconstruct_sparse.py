"""Reconstruct camera poses and a sparse cloud from matched photos.

Reads sfm/database.db, sfm/photos.json and the photos; writes sfm/model (COLMAP), sfm/report.json
and poses.npz (undistorted pinholes). Example:

    python scripts/reconstruct_sparse.py --database database.db --listing photos.json \\
        --photos photos/*.jpg --images model/images.bin --report report.json --poses poses.npz
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.photos import photo_files
from cherrypicker.runner import run, stage_parser
from cherrypicker.sfm.mapping import MappingOptions
from cherrypicker.sfm.sparse import reconstruct_sparse


def main(
    database: Annotated[str, "COLMAP database with matches"],
    listing: Annotated[str, "JSON of extract_features"],
    photos: Annotated[list[str], "photos of one folder"],
    images: Annotated[str, "images.bin; its folder takes the model"],
    report: Annotated[str, "JSON report to write"],
    poses: Annotated[str, "NPZ of undistorted poses to write"],
    photo_masks: Annotated[str | None, "folder of the photos' masks by a user"] = None,
    *,
    options: MappingOptions,
    seed: int = 0,
    threads: int = 2,
) -> None:
    reconstruct_sparse(
        database,
        photo_files(photos),
        listing,
        Path(images).parent,
        report,
        poses,
        options,
        masks=photo_masks or None,
        seed=seed,
        threads=threads,
    )


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
