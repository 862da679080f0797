"""Extract SIFT features of a tree's photos.

Reads the photos, writes sfm/features.db (COLMAP database) and sfm/photos.json. Example:

    python scripts/extract_features.py --photos photos/*.jpg --database features.db \\
        --listing photos.json
"""

from typing import Annotated

from cherrypicker.photos import photo_files
from cherrypicker.runner import run, stage_parser
from cherrypicker.sfm.features import FeatureOptions, extract_features


def main(
    photos: Annotated[list[str], "photos of one folder, or the folder"],
    database: Annotated[str, "COLMAP database to write"],
    listing: Annotated[str, "JSON to write: each photo, its camera"],
    photo_masks: Annotated[str | None, "folder of the photos' masks by a user"] = None,
    folder: Annotated[str, "folder of the photos, named in errors"] = "",
    *,
    options: FeatureOptions,
    seed: int = 0,
    threads: int = 2,
) -> None:
    extract_features(
        photo_files(photos),
        database,
        listing,
        options,
        folder=folder,
        masks=photo_masks or None,
        seed=seed,
        threads=threads,
    )


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
