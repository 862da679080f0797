"""Gather what a benchmark measured into a table of Markdown; of trunks also the page's picture.

Reads the JSON files of a benchmark's trees. Kinds: error_budget, series, skeletons, traits, trunks.
Example:

    python scripts/lab/report_benchmark.py --kind traits --table table.md \\
        --measured results/benchmark/traits/thin/*.json
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.files import read_json, write_text
from cherrypicker.runner import run, stage_parser


def error_budget(paths):
    from cherrypicker_lab.error_budget import markdown

    return markdown({Path(path).parent.name: read_json(path) for path in paths})


def series(paths):
    from cherrypicker_lab.series.tables import write_table

    return write_table([read_json(path) for path in paths])


def skeletons(paths):
    from cherrypicker_lab.skeletons.tables import gather, write_tables

    return write_tables(gather(paths))


def traits(paths):
    from cherrypicker_lab.traits.tables import write_table

    return write_table([read_json(path) for path in paths])


def trunks(paths):
    from cherrypicker_lab.skeletons.trunk_ratio import gather_trunks, write_ratio_table

    return write_ratio_table(gather_trunks(paths))


KINDS = {each.__name__: each for each in (error_budget, series, skeletons, traits, trunks)}


def main(
    kind: Annotated[str, ", ".join(KINDS)],
    measured: Annotated[Sequence[str], "what was measured of each tree, JSON"],
    table: Annotated[str, "Markdown to write"],
) -> None:
    """Read all, print and write the table."""
    if kind not in KINDS:
        raise StageError(f"no benchmark is called {kind!r}: {', '.join(KINDS)}")
    text = KINDS[kind](measured)
    logging.getLogger("cherrypicker").info("%s", text, extra={"console": True})
    if kind == "trunks":
        from cherrypicker_lab.skeletons.trunk_ratio import draw_ratio, gather_trunks

        draw_ratio(gather_trunks(measured), Path(table).with_name("trunk_ratio.png"))
    write_text(table, text)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
