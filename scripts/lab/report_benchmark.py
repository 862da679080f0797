"""Gather the benchmark of dense stereo into tables and figures.

Reads measurement.json files, with scores.json and scored.ply beside those of rendered scenes;
writes a Markdown table and PNG figures. Example:

    python scripts/lab/report_benchmark.py --table table.md --measurements \\
        results/benchmark/dense/*/*/*/*/measurement.json
"""

from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.files import write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.dense.backends import ALL_BACKENDS, backends_here
from cherrypicker_lab.dense.figures import (
    depth_figure,
    error_figure,
    save,
    score_figure,
    time_figure,
)
from cherrypicker_lab.dense.results import at_full_size, read_results, write_table


def main(measurements, table, *, backends):
    """Read all results, write the table and the figures beside it."""
    results = read_results(measurements)
    folder = Path(table).parent
    save(time_figure(results), folder / "time.png")
    if any(result.scores is not None for result in at_full_size(results)):
        save(score_figure(results), folder / "scores.png")
    groups = {}
    for result in at_full_size(results):
        groups.setdefault((result.scan, result.cameras), []).append(result)
    for (scan, cameras), group in groups.items():
        save(depth_figure(group), folder / f"depth_{scan}_{cameras}.png")
        if all(result.scores is not None for result in group):
            save(error_figure(group), folder / f"errors_{scan}_{cameras}.png")
    left_out = [name for name in backends if name not in backends_here()]
    write_text(table, write_table(results, left_out))


parser = stage_parser(__doc__)
parser.add_argument("--measurements", required=True, nargs="+", help="measurement.json files")
parser.add_argument("--table", required=True, help="Markdown to write; its folder takes figures")
parser.add_argument("--backends", nargs="*", default=list(ALL_BACKENDS), help="those asked for")
run(main, parser, globals().get("snakemake"))
