"""Write the tables and the page over all trees of the batch.

Reads every tree's traits.json and measures.json below results/, and what else is asked for, the
failures below logs/ and what jobs took below benchmarks/, of the current folder; writes
traits.csv, measures.csv, accuracy.csv and datapackage.json beside it, and summary.html. Example:

    python scripts/summarise_batch.py --trees cherry_1 cherry_2 --table results/traits.csv \\
        --page results/summary.html
"""

from collections.abc import Sequence
from typing import Annotated

from cherrypicker.batch.summary import summarise
from cherrypicker.errors import StageError
from cherrypicker.runner import run, stage_parser


def main(
    trees: Annotated[list[str], "ids of the trees"],
    table: Annotated[str, "CSV to write"],
    page: Annotated[str, "HTML to write"],
    dates: Annotated[Sequence[str], "ISO date of each tree's scan"] = (),
    series: Annotated[Sequence[str], "series of each tree's scan"] = (),
    parts: Annotated[
        Sequence[str],
        "what each tree has beside traits: measures, light, bearing, pruning, between spaces",
    ] = (),
    lacking: Annotated[Sequence[str], "what of this failed or is out of date, likewise"] = (),
) -> None:
    parts = parts or ["measures"] * len(trees)
    dates, series, lacking = (given or [""] * len(trees) for given in (dates, series, lacking))
    if not len(trees) == len(dates) == len(series) == len(parts) == len(lacking):
        raise StageError(f"{len(trees)} trees, {len(dates)} dates and {len(series)} series given")
    rows = [
        {"tree": tree, "date": date, "series": name}
        | {"parts": kinds.split(), "lacking": missing.split()}
        for tree, date, name, kinds, missing in zip(
            trees, dates, series, parts, lacking, strict=True
        )
    ]
    summarise(rows, table, page)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
