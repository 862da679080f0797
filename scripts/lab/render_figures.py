"""Take what was measured into docs/figures.json, and render the pages' tables from that file.

Without options the tables alone are rendered, and the pages of config keys and traits are written.
With --demo or --budget the figures of the trees that are finished there are taken first, with
--peers those of the benchmark of peers, with --table and --name a table as a benchmark's script
wrote it.
Example:

    python scripts/lab/render_figures.py --demo results --budget results/error_budget
"""

import datetime
import logging
from pathlib import Path
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.files import PROJECT, read_json, write_json, write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.published import (
    FIGURES,
    measure_budget,
    measure_demo,
    measure_peers,
    pages,
    read_table,
    render,
)
from cherrypicker_lab.written_pages import written_pages


def main(
    demo: Annotated[str, "results of the demo, finished"] = "",
    budget: Annotated[str, "results/error_budget of the demo"] = "",
    peers: Annotated[str, "results/benchmark/skeleton after benchmark_peers"] = "",
    table: Annotated[str, "table.md of a benchmark, whose first table is taken"] = "",
    name: Annotated[str, "what pages call that table"] = "",
    command: Annotated[str, "what measured it; left out, as the last time"] = "",
) -> None:
    """Measure what is asked for, save it, render every page."""
    figures = read_json(PROJECT / FIGURES)
    today = datetime.date.today().isoformat()
    for section, folder in (("demo", demo), ("error_budget", budget)):
        if not folder:
            continue
        for tree in figures[section]["trees"]:
            truth = PROJECT / "resources/demo" / tree / "truth"
            taken = (
                measure_demo(Path(folder), tree, truth)
                if section == "demo"
                else measure_budget(Path(folder), tree)
            )
            figures[section]["trees"][tree] = taken
        figures[section]["date"] = today
    if peers:
        figures["peers"] |= {"date": today} | measure_peers(Path(peers))
    if table:
        taken = read_table(Path(table).read_text(encoding="utf-8"))
        known = figures["tables"].get(name, {})
        figures["tables"][name] = {"command": command or known["command"], "date": today} | taken
    write_json(PROJECT / FIGURES, figures)
    for page in pages(PROJECT):
        write_text(page, render(page.read_text(encoding="utf-8"), figures))
        logging.getLogger("cherrypicker").info("%s is rendered", page.relative_to(PROJECT))
    for path, text in written_pages(PROJECT).items():
        write_text(PROJECT / path, text)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
