"""Gather the benchmark of skeletons into tables and figures.

Reads scores.json files (with skeletons.npz beside them) and times.json files; writes a Markdown
table, with figures beside it. Example:

    python scripts/lab/report_skeletons.py --table table.md \\
        --scores results/benchmark/skeleton/*/*.json
"""

from pathlib import Path

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.files import read_json, write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.outputs import save
from cherrypicker_lab.skeletons.figures import skeleton_figure
from cherrypicker_lab.skeletons.methods import SETTINGS
from cherrypicker_lab.skeletons.tables import METHOD_NAMES, gather, write_tables

SHOWN = ("peer_lbc", "peer_slbc", "lbc_paper", "slbc_paper", "slbc_default")


def main(scores, table, *, times=()):
    """Read all, write the tables and the figures."""
    found, folder = gather(scores), Path(table).parent
    timed = [read_json(path) for path in times]
    for tree, arrays in _skeletons(scores).items():
        for setting in SETTINGS:
            shown = {
                METHOD_NAMES[name]: arrays[f"{setting}_{name}"]
                for name in SHOWN
                if f"{setting}_{name}" in arrays
            }
            if f"{setting}_slbc_default_tree" in arrays:
                shown["limbs"] = arrays[f"{setting}_slbc_default_tree"]
            figure = skeleton_figure(
                f"{tree}, {setting}", arrays[f"{setting}_cloud"], arrays["truth"], shown
            )
            save(figure, folder / f"skeletons_{tree}_{setting}.png")
    write_text(table, write_tables(found, timed))


def _skeletons(scores):
    """Arrays of the first tree of each template, ours and the peer's together."""
    chosen = {}
    for path in scores:
        report = read_json(path)
        tree = chosen.setdefault(report["template"], (report["tree"], []))
        if tree[0] == report["tree"]:
            tree[1].append(Path(path).with_name(Path(path).name.replace("scores", "skeletons")))
    merged = {}
    for tree, paths in chosen.values():
        merged[tree] = {}
        for path in paths:
            with np.load(path.with_suffix(".npz"), allow_pickle=False) as stored:
                merged[tree] |= {key: stored[key] for key in stored.files}
    return merged


parser = stage_parser(__doc__)
parser.add_argument("--scores", required=True, nargs="+", help="scores of trees, JSON")
parser.add_argument("--times", nargs="*", default=[], help="times of clouds, JSON")
parser.add_argument("--table", required=True, help="Markdown to write; its folder takes figures")
run(main, parser, globals().get("snakemake"))
