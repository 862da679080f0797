"""Match the features of a tree's photos and verify the matches.

Reads sfm/features.db, writes sfm/database.db, a copy with matches. Example:

    python scripts/match_features.py --features features.db --database database.db
"""

from cherrypicker.runner import run, stage_parser
from cherrypicker.sfm.matching import MatchingOptions, match_features


def main(features, database, *, seed, threads, **options):
    match_features(features, database, MatchingOptions(**options), seed=seed, threads=threads)


parser = stage_parser(__doc__)
parser.add_argument("--features", required=True, help="COLMAP database with features")
parser.add_argument("--database", required=True, help="COLMAP database to write")
parser.add_argument(
    "--pairing",
    default="auto",
    choices=("auto", "exhaustive", "retrieval", "sequential", "vocab_tree"),
    help="which photos are matched with which",
)
parser.add_argument("--exhaustive_max_photos", type=int, default=80, help="limit of auto")
parser.add_argument("--retrieval_neighbors", type=int, default=30, help="similar photos a photo")
parser.add_argument("--sequential_overlap", type=int, default=8, help="next photos a photo")
parser.add_argument("--vocab_tree_path", default="", help="COLMAP's vocabulary tree")
parser.add_argument("--max_ratio", type=float, default=0.8, help="ratio test")
parser.add_argument("--max_error_px", type=float, default=4.0, help="epipolar error, px")
parser.add_argument("--min_inliers", type=int, default=15, help="matches of a verified pair")
parser.add_argument("--guided", action="store_true", help="search again along epipolar lines")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
run(main, parser, globals().get("snakemake"))
