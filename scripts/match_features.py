"""Match the features of a tree's photos and verify the matches.

Reads sfm/features.db, writes sfm/database.db, a copy with matches. Example:

    python scripts/match_features.py --features features.db --database database.db
"""

from cherrypicker.runner import run, stage_parser
from cherrypicker.sfm.matching import MatchingOptions, match_features


def main(features, database, *, options: MatchingOptions, seed: int = 0, threads: int = 2):
    match_features(features, database, options, seed=seed, threads=threads)


parser = stage_parser(__doc__)
parser.add_argument("--features", required=True, help="COLMAP database with features")
parser.add_argument("--database", required=True, help="COLMAP database to write")
run(main, parser, globals().get("snakemake"))
