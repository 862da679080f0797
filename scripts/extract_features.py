"""Extract SIFT features of a tree's photos.

Reads the photos, writes sfm/features.db (COLMAP database) and sfm/photos.json. Example:

    python scripts/extract_features.py --photos photos/*.jpg --database features.db \\
        --listing photos.json
"""

from cherrypicker.runner import run, stage_parser
from cherrypicker.sfm.features import extract_features


def main(photos, database, listing, *, folder, threads, seed, **options):
    extract_features(
        photos, database, listing, folder=folder, seed=seed, threads=threads, **options
    )


parser = stage_parser(__doc__)
parser.add_argument("--photos", required=True, nargs="*", help="photos of one folder")
parser.add_argument("--database", required=True, help="COLMAP database to write")
parser.add_argument("--listing", required=True, help="JSON to write: each photo, its camera")
parser.add_argument("--folder", default="", help="folder of the photos, named in errors")
parser.add_argument("--camera_mode", default="folder", choices=("folder", "auto", "per_image"))
parser.add_argument("--camera_model", default="SIMPLE_RADIAL", help="COLMAP's camera model")
parser.add_argument("--max_features", type=int, default=4000, help="features per photo")
parser.add_argument("--max_image_size_px", type=int, default=2400, help="0: full size")
parser.add_argument("--skip_unreadable", action="store_true", help="leave unreadable photos out")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
run(main, parser, globals().get("snakemake"))
