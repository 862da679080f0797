"""Make the photos that every stage reads from a tree's photos and videos.

Reads the files of one folder and, where there are, the user's masks; writes the prepared photos,
their masks (``{name}.png``, black = hidden) and what became of each file. Example:

    python scripts/prepare_photos.py --captures walk.mp4 IMG_1.HEIC --photos results/tree/photos \\
        --photo_masks results/tree/photo_masks --listing results/tree/photos.json
"""

from typing import Annotated

from cherrypicker.files import write_json
from cherrypicker.intake.kinds import list_captures
from cherrypicker.intake.prepare import PrepareOptions, prepare_photos
from cherrypicker.runner import run, stage_parser


def main(
    captures: Annotated[list[str], "photos and videos of one folder"],
    photos: Annotated[str, "folder of prepared photos to write"],
    photo_masks: Annotated[str, "folder of their masks to write"],
    listing: Annotated[str, "JSON to write: what became of each file"],
    folder: Annotated[str, "folder of the photos, named in errors"] = "",
    masks: Annotated[str, "folder of the user's masks; none if empty"] = "",
    *,
    options: PrepareOptions,
    threads: int = 2,
) -> None:
    files = captures or list_captures(folder)
    made = prepare_photos(files, photos, photo_masks, options, user_masks=masks, threads=threads)
    write_json(listing, made)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
