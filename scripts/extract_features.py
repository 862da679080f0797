"""Extract SIFT features of a tree's photos.

Reads the photos, writes sfm/features.db (COLMAP database) and sfm/photos.json. Example:

    python scripts/extract_features.py --photos photos/*.jpg --database features.db \\
        --listing photos.json
"""

from cherrypicker.runner import run, stage_parser
from cherrypicker.sfm.features import FeatureOptions, extract_features


def main(
    photos,
    database,
    listing,
    folder,
    *,
    options: FeatureOptions,
    seed: int = 0,
    threads: int = 2,
):
    extract_features(photos, database, listing, options, folder=folder, seed=seed, threads=threads)


parser = stage_parser(__doc__)
parser.add_argument("--photos", required=True, nargs="*", help="photos of one folder")
parser.add_argument("--database", required=True, help="COLMAP database to write")
parser.add_argument("--listing", required=True, help="JSON to write: each photo, its camera")
parser.add_argument("--folder", default="", help="folder of the photos, named in errors")
run(main, parser, globals().get("snakemake"))
