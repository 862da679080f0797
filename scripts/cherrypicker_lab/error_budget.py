"""What each stage costs, on a generated scene: its output is replaced by the truth, one by one.

The rungs of a ladder: the tree as found; the same with the true poses; with the true depth as well;
with the true labels; with the true skeleton. The stages after the one replaced are the workflow's
own, so the drop of an error from one rung to the next is what that stage costs, and what is left at
the last rung is the cost of the traits. A
negative cost says that the stages after had made up for the error, or that errors cancelled out.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import yaml

from cherrypicker.errors import StageError
from cherrypicker.files import read_json, write_text
from cherrypicker_lab.evaluation import evaluate
from cherrypicker_lab.tables import markdown_table
from cherrypicker_lab.truth_swaps import (
    place_true_depth,
    place_true_labels,
    place_true_poses,
    place_true_skeleton,
    take_over,
)

RUNGS = ("found", "true_poses", "true_depth", "true_labels", "true_skeleton")
NAMES = {
    "found": "as found",
    "true_poses": "+ true poses",
    "true_depth": "+ true depth",
    "true_labels": "+ true labels",
    "true_skeleton": "+ true skeleton",
}
#: The stage whose cost the step to each rung shows.
STAGES = {
    "true_poses": "poses (structure from motion)",
    "true_depth": "depth (stereo)",
    "true_labels": "labels (segmentation)",
    "true_skeleton": "skeleton (crop, denoising, contraction, graph, radii)",
    "rest": "traits",
}
#: Errors, in percent of the truth.
MEASURES = {
    "recall": "skeleton recall",
    "recall_all": "the same, all wood",
    "trunk": "trunk diameter",
    "length": "total length",
}
#: Those that a stage's cost is the sum of; recall of thick wood is part of that of all wood.
SUMMED = ("recall_all", "trunk", "length")

_COLUMNS = ("photos", "marker_dictionary", "marker_sides_m", "scale", "date")


def errors_of(report: Mapping, truth: Mapping) -> dict[str, float]:
    """Return `MEASURES` in percent, of an `evaluate` report and the truth's ``traits.json``."""
    return {
        "recall": 100 * (1 - report["skeleton_recall"]),
        "recall_all": 100 * (1 - report["skeleton_recall_all"]),
        "trunk": 100 * report["trunk_diameter_error_m"] / truth["trunk_diameter_m"],
        "length": 100 * abs(report["total_length_m_ratio"] - 1),
    }


def costs_of(ladder: Mapping[str, Mapping]) -> dict[str, dict[str, float]]:
    """Return what each of `STAGES` costs: the drop of each error on the way to its rung.

    The ladder has `errors_of` of each of `RUNGS`. A cost is in percent, one for each of `MEASURES`,
    and ``sum`` over `SUMMED`.
    """
    costs = {}
    for before, rung in zip(RUNGS, [*RUNGS[1:], "rest"]):
        after = ladder.get(rung, dict.fromkeys(MEASURES, 0.0))
        cost = {name: ladder[before][name] - after[name] for name in MEASURES}
        costs[rung] = cost | {"sum": sum(cost[name] for name in SUMMED)}
    return costs


def dearest(costs: Mapping[str, Mapping], measure: str = "sum") -> str:
    """Return the stage that costs most in a measure; the earlier one of equals."""
    return max(costs, key=lambda stage: costs[stage][measure])


def climb(
    found: Path,
    truth: Path,
    folder: Path,
    *,
    tree: str,
    row: Mapping[str, str],
    settings: Mapping,
    snakefile: Path,
    threads: int,
) -> dict:
    """Run the ladder of one tree.

    `found` is ``results/{tree}``, complete, `truth` is ``{scene}/truth``; a working folder per rung
    goes below `folder`. `row` is the tree's in ``trees.tsv``, `settings` its config with all keys,
    and `snakefile` the workflow whose stages run.

    Returns ``ladder``: `errors_of` of each rung, ``values``: what the evaluation said of it,
    ``costs``: `costs_of`, and ``dearest``: the stage that costs most. Raises a `StageError` when
    the truth or the results are not complete, or a stage fails on the truth.
    """
    traits = read_json(truth / "traits.json")
    photos, seed = Path(row["photos"]).absolute(), settings["seed"]
    values, before = {"found": evaluate(found, truth)}, found
    for rung in RUNGS[1:]:
        here = folder / rung / "results" / tree
        write_work_folder(folder / rung, tree, row, settings)
        take_over(before, here)
        if rung == "true_poses":
            placed = place_true_poses(here, photos, truth, seed=seed, threads=threads)
        elif rung == "true_depth":
            placed = place_true_depth(here, truth, threads=threads)
        elif rung == "true_labels":
            placed = place_true_labels(here, truth)
        else:
            placed = place_true_skeleton(here, truth)
        times = [file.stat().st_mtime_ns for file in placed]
        run_stages(snakefile, folder / rung, f"results/{tree}/traits.json", threads)
        for file, time in zip(placed, times):
            if file.stat().st_mtime_ns != time:
                raise StageError("a stage ran again and overwrote the truth", file=file)
        values[rung], before = evaluate(here, truth), here
    ladder = {rung: errors_of(values[rung], traits) for rung in RUNGS}
    costs = costs_of(ladder)
    return {"ladder": ladder, "values": values, "costs": costs, "dearest": dearest(costs)}


def write_work_folder(folder: Path, tree: str, row: Mapping[str, str], settings: Mapping) -> None:
    """Write config.yaml and trees.tsv of a working folder with one tree."""
    cells = {name: row.get(name, "") for name in _COLUMNS}
    cells["photos"] = str(Path(cells["photos"]).absolute())
    lines = ["\t".join(["tree", *cells]), "\t".join([tree, *cells.values()])]
    own = {name: dict(value) if isinstance(value, Mapping) else value
           for name, value in settings.items()}  # fmt: skip
    own["trees"], own["keep"] = "config/trees.tsv", {"dense": True}
    for section in ("sky", "segment"):
        if own[section].get("weights"):
            own[section]["weights"] = str(Path(own[section]["weights"]).absolute())
    (folder / "config").mkdir(parents=True, exist_ok=True)
    write_text(folder / "config/trees.tsv", "\n".join(lines) + "\n")
    write_text(folder / "config/config.yaml", yaml.safe_dump(own))


def run_stages(snakefile: Path, folder: Path, target: str, threads: int) -> None:
    """Run the workflow in a working folder up to a target.

    Only times decide what is due: what was put there from the truth has no history. Raises a
    `StageError` when a stage fails; its log lies in the folder.
    """
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(snakefile)]
    command += ["--directory", str(folder), "--cores", str(threads), "--quiet", "all"]
    command += ["--rerun-triggers", "mtime", "--nocolor", "--", target]
    # A rule of the outer run may have settings of its own in the environment.
    clean = {k: v for k, v in os.environ.items() if not k.startswith("SNAKEMAKE")}
    done = subprocess.run(command, env=clean, check=False)
    if done.returncode:
        raise StageError(
            f"a stage failed on the truth (exit code {done.returncode}); its log is in {folder}",
            file=folder / target,
        )


def markdown(budgets: Mapping[str, Mapping]) -> str:
    """Return the tables of several trees, `climb` by tree, as Markdown.

    A budget that is kept for long brings the names of its rungs and stages (``names``, ``stages``):
    another version may have others.
    """
    return "\n".join(_of_tree(tree, budget) for tree, budget in budgets.items())


def _of_tree(tree: str, budget: Mapping) -> str:
    names, stages = budget.get("names", NAMES), budget.get("stages", STAGES)
    rungs = [
        [name, *(f"{budget['ladder'][rung][measure]:.2f}" for measure in MEASURES)]
        for rung, name in names.items()
    ]
    rows = [
        [
            f"**{what}**" if stage == budget["dearest"] else what,
            *(f"{budget['costs'][stage][measure]:+.2f}" for measure in (*MEASURES, "sum")),
        ]
        for stage, what in stages.items()
    ]
    errors = markdown_table(["", *(f"{what}, error %" for what in MEASURES.values())], rungs)
    costs = markdown_table(["stage", *MEASURES.values(), "sum"], rows)
    most = [
        f"{what} {stages[dearest(budget['costs'], measure)]}" for measure, what in MEASURES.items()
    ]
    said = f"Costs most: {stages[budget['dearest']]}. By measure: {'; '.join(most)}."
    return f"### {tree}\n\n{errors}\n{costs}\n{said}\n"
