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

import lab_path  # noqa: F401
from cherrypicker.files import PROJECT, read_json, write_json, write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.published import (
    FIGURES,
    PAGES,
    measure_budget,
    measure_demo,
    measure_peers,
    read_table,
    render,
)
from cherrypicker_lab.written_pages import written_pages


def main(demo=None, budget=None, peers=None, table=None, name=None, command=None):
    """Measure what is asked for, save it, render every page."""
    figures = read_json(PROJECT / FIGURES)
    today = datetime.date.today().isoformat()
    for section, folder in (("demo", demo), ("error_budget", budget)):
        if folder is None:
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
    if peers is not None:
        figures["peers"] |= {"date": today} | measure_peers(Path(peers))
    if table is not None:
        taken = read_table(Path(table).read_text(encoding="utf-8"))
        known = figures["tables"].get(name, {})
        figures["tables"][name] = {"command": command or known["command"], "date": today} | taken
    write_json(PROJECT / FIGURES, figures)
    for page in PAGES:
        text = (PROJECT / page).read_text(encoding="utf-8")
        write_text(PROJECT / page, render(text, figures))
        logging.getLogger("cherrypicker").info("%s is rendered", page)
    for page, text in written_pages(PROJECT).items():
        write_text(PROJECT / page, text)


parser = stage_parser(__doc__)
parser.add_argument("--demo", help="results of the demo, finished")
parser.add_argument("--budget", help="results/error_budget of the demo")
parser.add_argument("--peers", help="results/benchmark/skeleton after benchmark_peers")
parser.add_argument("--table", help="table.md of a benchmark, whose first table is taken")
parser.add_argument("--name", help="what pages call that table")
parser.add_argument("--command", help="what measured it; left out, as the last time")
run(main, parser, globals().get("snakemake"))
