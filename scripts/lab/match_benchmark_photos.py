"""Extract and match the features of a benchmark's scan.

Reads a folder of photos; writes COLMAP databases, with features alone and with verified matches,
and the list of the photos. Example:

    python scripts/lab/match_benchmark_photos.py --folder scenes/tree/photos \\
        --features features.db --database database.db --listing photos.json
"""

import lab_path  # noqa: F401
from cherrypicker.photos import list_photos
from cherrypicker.runner import run, stage_parser
from cherrypicker.sfm.features import extract_features
from cherrypicker.sfm.matching import match_features


def main(folder, features, database, listing, *, seed: int = 0, threads: int = 2):
    """Both stages with their default options."""
    photos = list_photos(folder)
    extract_features(photos, features, listing, folder=folder, seed=seed, threads=threads)
    match_features(features, database, seed=seed, threads=threads)


parser = stage_parser(__doc__)
parser.add_argument("--folder", required=True, help="folder of photos")
parser.add_argument("--features", required=True, help="COLMAP database of features to write")
parser.add_argument("--database", required=True, help="COLMAP database with matches to write")
parser.add_argument("--listing", required=True, help="JSON to write: each photo, its camera")
run(main, parser, globals().get("snakemake"))
