"""Set a tree's hand measurements beside ours.

Reads the table of hand measurements and the tree's traits.json, branches.csv and skeleton.graphml,
for a scan from photos scale.json and photo_check.json; writes measures.json. Example:

    python scripts/compare_measures.py --tree cherry --table config/measures.csv \\
        --traits traits.json --branches branches.csv --skeleton skeleton.graphml \\
        --measures measures.json
"""

import logging
from typing import Annotated

from cherrypicker.accuracy.compare import ComparedTree
from cherrypicker.accuracy.measures import read_measures
from cherrypicker.files import read_json, write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker.skeleton import read_skeleton
from cherrypicker.traits.branches import read_branches

logger = logging.getLogger("cherrypicker.compare_measures")


def main(
    tree: Annotated[str, "the tree's id"],
    table: Annotated[str, "CSV of hand measurements"],
    traits: Annotated[str, "traits.json"],
    branches: Annotated[str, "branches.csv"],
    skeleton: Annotated[str, "skeleton.graphml"],
    measures: Annotated[str, "JSON to write"],
    scale: Annotated[str | None, "scale.json of a scan from photos"] = None,
    photo_check: Annotated[str | None, "photo_check.json of a scan from photos"] = None,
) -> None:
    ours = ComparedTree(
        read_json(traits),
        read_branches(branches),
        read_skeleton(skeleton),
        scale=read_json(scale) if scale else None,
        photo_check=read_json(photo_check) if photo_check else None,
    )
    pairs = [ours.pair(measure) for measure in read_measures(table) if measure.tree == tree]
    for pair in pairs:
        for text in [pair["problem"]] * bool(pair["problem"]) + pair["doubts"]:
            logger.warning("line %d of %s: %s", pair["line"], table, text)
    write_json(measures, {"measures": pairs})


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
