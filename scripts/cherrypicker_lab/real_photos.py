"""A scoreboard of real scans, which have no truth: what the run itself says of each.

Everything is read from the files that the stages leave, so that a scan that stopped on the way has
a row as well, with the stage and the cause.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from cherrypicker.files import read_json

#: Columns of the table: key, heading, how a value is written.
COLUMNS = {
    "registered": ("photos registered", "{}"),
    "reprojection_px": ("reprojection error, px", "{:.2f}"),
    "held": ("thin wood in the photos that the depth maps hold", "{:.0%}"),
    "photo_precision": ("photo precision", "{:.3f}"),
    "photo_recall": ("photo recall", "{:.3f}"),
    "sky_share": ("crown before sky", "{:.0%}"),
    "cpu_min": ("CPU min", "{:.0f}"),
    "outcome": ("flags, or what stopped it", "{}"),
}


def scan_row(tree: str, results: Path, benchmarks: Path, status: dict[str, str]) -> dict[str, Any]:
    """Collect what a run left of one scan.

    Parameters
    ----------
    tree : str
    results, benchmarks : Path
        Folders of the run; ``benchmarks`` holds a table of time for each stage.
    status : dict of str to str
        The tree's row of ``traits.csv``.

    Returns
    -------
    dict
        Values of `COLUMNS`; what the run did not come to is missing.
    """
    names = [flag.partition(": ")[0] for flag in status["flags"].split("; ")]
    names = [name for name in names if name.isidentifier()]
    folder, row = results / tree, {"outcome": ", ".join(names) or "none"}
    if status["failed_stage"]:
        row["outcome"] = f"{status['failed_stage']}: {status['cause']}"
    if sparse := _json(folder / "sfm/report.json"):
        row["registered"] = f"{sparse['n_registered']} of {sparse['n_photos']}"
        row["reprojection_px"] = sparse["mean_reprojection_error_px"]
    if coverage := _json(folder / "dense/coverage.json"):
        wood = np.array(coverage["p_wood"]) > 0.5
        if wood.any():
            row["held"] = float((np.array(coverage["n_holding"])[wood] > 0).mean())
    check = _json(folder / "photo_check.json")
    row |= {key: check.get(key) for key in ("photo_precision", "photo_recall")}
    row["sky_share"] = check.get("photo_sky_share")
    seconds = []
    for path in sorted(benchmarks.glob(f"*/{tree}.tsv")):
        with path.open(newline="") as handle:
            seconds += [float(line["cpu_time"]) for line in csv.DictReader(handle, delimiter="\t")]
    row["cpu_min"] = sum(seconds) / 60
    return row


def _json(path: Path) -> dict[str, Any]:
    return read_json(path) if path.is_file() else {}


def markdown(rows: dict[str, dict[str, Any]]) -> str:
    """Return the scans' rows as a table of Markdown."""
    lines = [
        f"| scan | {' | '.join(heading for heading, _ in COLUMNS.values())} |",
        f"|---|{'---:|' * (len(COLUMNS) - 1)}---|",
    ]
    for tree, row in rows.items():
        cells = [
            "-" if row.get(key) is None else form.format(row[key])
            for key, (_, form) in COLUMNS.items()
        ]
        lines.append(f"| {tree} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
