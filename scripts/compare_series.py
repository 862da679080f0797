"""Compare the scans of one tree on several dates: growth, new shoots, removed wood.

Reads skeleton.graphml, branches.csv, limbs.csv, traits.json, segmented.ply and, of scans from
photos, scale.json and align.json below each tree's results folder; writes tables and a page. A scan
that cannot be compared is told and left out. Example:

    python scripts/compare_series.py --series row3_tree4 --trees t4_2025 t4_2026 \\
        --dates 2025-02-11 2026-02-14 --page report.html --numbers series.json \\
        --branch_table branches.csv --growth growth.csv --shoots shoots.csv --cuts cuts.csv \\
        --bearing bearing.csv
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cherrypicker.bearing.two_dates import DATED_COLUMNS, bearing_by_two_dates
from cherrypicker.errors import StageError
from cherrypicker.files import csv_text, write_json, write_text
from cherrypicker.pruning.table import CUT_COLUMNS as PRUNING_COLUMNS
from cherrypicker.report.series_page import series_page
from cherrypicker.runner import run, stage_parser
from cherrypicker.series.compare import compare_scans
from cherrypicker.series.made_cuts import made_cuts
from cherrypicker.series.scan_files import read_scan
from cherrypicker.series.tables import TABLES, as_csv, totals
from cherrypicker.traits.branches import read_branches

logger = logging.getLogger(__name__)


def main(
    series: Annotated[str, "name of the series"],
    trees: Annotated[list[str], "ids of its trees"],
    dates: Annotated[list[str], "ISO date of each tree's scan"],
    page: Annotated[str, "HTML to write"],
    numbers: Annotated[str, "JSON of totals to write"],
    branch_table: Annotated[str, "CSV of branches to write"],
    growth: Annotated[str, "CSV of growth to write"],
    shoots: Annotated[str, "CSV of new shoots to write"],
    cuts: Annotated[str, "CSV of removed wood to write"],
    bearing: Annotated[str, "CSV of kinds and ages by two dates to write"],
    unfinished: Annotated[Sequence[str], "ids of its trees that failed, to be named"] = (),
    pruning: Annotated[Sequence[str], "pruning.csv of its trees that have one"] = (),
) -> None:
    if len(trees) != len(dates):
        raise StageError(f"{len(trees)} trees and {len(dates)} dates given")
    scans, left_out = [], dict.fromkeys(unfinished, "it is not finished")
    for tree, date in zip(trees, dates, strict=True):
        try:
            scans.append(read_scan(Path("results", tree), tree, date))
        except StageError as error:
            left_out[tree] = error.describe()
            logger.warning("%s is left out: %s", tree, left_out[tree])
    if len(scans) < 2:
        raise StageError(
            f"series {series} has fewer than two scans to compare: " + "; ".join(left_out.values()),
            key="series in trees.tsv",
        )
    comparison = compare_scans(scans)
    comparison.left_out |= left_out
    files = {"branches": branch_table, "growth": growth, "shoots": shoots, "cuts": cuts}
    tables = {name: make(comparison) for name, (make, _) in TABLES.items()}
    for name, (_, columns) in TABLES.items():
        write_text(files[name], as_csv(tables[name], columns))
    told = totals(comparison)
    plans = {Path(path).parent.name: read_branches(path, PRUNING_COLUMNS) for path in pruning}
    dated = []
    for step, each, ids in zip(comparison.steps, told["steps"], comparison.ids[1:], strict=True):
        if step.earlier.tree in plans:
            each["proposed"] = made_cuts(step, plans[step.earlier.tree])
        try:
            ages, rows = bearing_by_two_dates(step, ids, Path("results", step.later.tree))
        except StageError as error:  # the comparison stands without
            each["warnings"].append(f"no_ages: {error.describe()}")
            ages, rows = None, []
        each["bearing"] = ages
        dated += rows
    write_text(bearing, csv_text(dated, DATED_COLUMNS))
    write_json(numbers, {"series": series, **told})
    write_text(page, series_page(series, comparison, tables, told["steps"]))


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
