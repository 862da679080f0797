"""Measure kinds and ages of bearing wood on grown trees of known years, by one date or by two.

Example:

    python scripts/lab/measure_bearing_wood.py --forms spindle --seeds 1 2 4 --seen --output a.json
"""

from collections.abc import Sequence
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.bearing.rates import read_rates
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.bearing.score import score_tree, summarise
from cherrypicker_lab.bearing.trees import (
    as_seen_tree,
    odds_by_year_before,
    year_before,
    year_tree,
)


def main(
    forms: Annotated[Sequence[str], "of `YEAR_FORMS`"],
    seeds: Annotated[Sequence[int], "trees of each form"],
    output: Annotated[str, "JSON to write"],
    *,
    seen: bool = False,
    two_dates: bool = False,
) -> None:
    """Grow, see where asked for, a year before too, tell, compare, save."""
    rates, scores = read_rates(), []
    for form in forms:
        for seed in seeds:
            tree, true = year_tree(form, seed)
            told = as_seen_tree(tree, true, seed) if seen or two_dates else true
            dated = None
            if two_dates:
                dated = odds_by_year_before(year_before(form, seed, tree), told, rates.n_ages)
            scores.append(score_tree(told, rates, truth=true, dated=dated))
    write_json(output, {"totals": summarise(scores), "trees": scores})


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
