"""Match the features of a tree's photos and verify the matches.

Reads sfm/features.db, writes sfm/database.db, a copy with matches. Example:

    python scripts/match_features.py --features features.db --database database.db
"""

from typing import Annotated

from cherrypicker.runner import run, stage_parser
from cherrypicker.sfm.matching import MatchingOptions, match_features


def main(
    features: Annotated[str, "COLMAP database with features"],
    database: Annotated[str, "COLMAP database to write"],
    *,
    options: MatchingOptions,
    seed: int = 0,
    threads: int = 2,
) -> None:
    match_features(features, database, options, seed=seed, threads=threads)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
