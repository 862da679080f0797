"""Halve and double named numbers of the program, one at a time, and score a scan's cloud each time.

A guess is to become an ablation or to go. In a copy of the tracked files one number after another
is changed, and Snakemake makes the cloud of a finished scan of a scene with a known truth anew,
which runs the rules that read the number and no others. Prints F1 of all wood, of branches of 5 to
10 mm of radius and of thinner ones, each at 5 and 10 mm of the true surface (score_surface.py), and
the processor's seconds of what ran; first with nothing changed. A scan that keeps its dense
workspace (keep.dense) spares the steps before. Example:

    python scripts/lab/ablate_numbers.py --scan SCAN --tree tree --truth SCENE/truth \\
        --only mvs/views
"""

import ast
import csv
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

from count_numbers import PACKAGE, named_numbers

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.files import write_json
from cherrypicker.pointcloud import read_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.dense.surface import lay_over, score_cloud
from cherrypicker_lab.dense.truth import load_true_surface
from cherrypicker_lab.tracked import copy_tracked

PROJECT = PACKAGE.parents[1]
CLOUD, POSES = "cloud.ply", "dense/poses.npz"


def main(
    scan: Annotated[str, "working directory of a finished scan, with its config.yaml"],
    tree: Annotated[str, "the tree's name"],
    truth: Annotated[str, "SCENE/truth"],
    scores: Annotated[str, "JSON to write"],
    only: Annotated[str, "part of the path of the modules"] = "mvs",
    numbers: Annotated[tuple[str, ...], "NAME or NAME=EXPRESSION; else all guesses"] = (),
    factors: Annotated[tuple[float, ...], "of those without expression"] = (0.5, 2.0),
    cores: Annotated[int, "of the processor"] = 1,
) -> None:
    changes = [None, *all_changes(only, dict(n.partition("=")[::2] for n in numbers), factors)]
    if len(changes) == 1:
        raise StageError("no number is in there", key="--only")
    surface = load_true_surface(truth)
    made = Path(scan, "results", tree)
    move = lay_over(read_cloud(made / CLOUD).points, made / POSES, truth, surface)
    rows = []
    with tempfile.TemporaryDirectory(prefix="numbers.", dir=Path(scan).parent) as folder:
        project = Path(folder, "project")
        copy_tracked(PROJECT, project)
        for change in changes:
            here = Path(folder, "scan")
            _copy(Path(scan), here)
            spent = _make(project, here, tree, change, cores)
            wood = score_cloud(move(read_cloud(here / "results" / tree / CLOUD).points), surface)
            rows.append(_row(change, spent, wood))
            write_json(scores, {"rows": rows})  # a change that no stage survives ends the others
            print("  ".join(str(value) for value in rows[-1].values()), flush=True)
            shutil.rmtree(here)


def all_changes(only, chosen, factors):
    """Of each change: the module, what changes, the statement and what it becomes.

    Numbers of one statement change together, by the name of the first.
    """
    for path in sorted(PACKAGE.rglob("*.py")):
        if only not in str(path.relative_to(PACKAGE)):
            continue
        source = path.read_text(encoding="utf-8")
        before = None
        for name, is_guess, statement in named_numbers(source):
            if statement is before or (name not in chosen if chosen else not is_guess):
                continue
            before, old = statement, ast.get_source_segment(source, statement)
            if chosen.get(name):
                yield path.relative_to(PROJECT), name, chosen[name], old, f"{name} = {chosen[name]}"
                continue
            for factor in factors:
                yield path.relative_to(PROJECT), name, factor, old, _times(old, factor)


def _times(old, factor):
    """A statement with all its numbers multiplied; whole ones stay whole, and at least one."""

    class Multiply(ast.NodeTransformer):
        def visit_Constant(self, node):
            if type(node.value) is int:
                node.value = int(node.value * factor) or (1 if node.value else 0)
            elif type(node.value) is float:
                node.value *= factor
            return node

    return ast.unparse(Multiply().visit(ast.parse(old)))


def _copy(scan, here):
    """Copy a working directory; its results by links, which no rule writes to."""
    shutil.copytree(scan / ".snakemake" / "metadata", here / ".snakemake" / "metadata")
    for path in scan.iterdir():
        if path.name == "results":
            shutil.copytree(path, here / path.name, copy_function=os.link)
        elif path.is_file():
            shutil.copy2(path, here / path.name)


def _make(project, here, tree, change, cores):
    """Make the cloud with a change, and return the processor's seconds of what ran."""
    path, name, factor, old, new = change or (None,) * 5
    if path:
        text = (project / path).read_text(encoding="utf-8")
        assert text.count(old) == 1, (path, old)
        (project / path).write_text(text.replace(old, new), encoding="utf-8")
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(project / "Snakefile")]
    command += ["--directory", str(here), "--configfile", str(here / "config.yaml")]
    command += ["--cores", str(cores), "--quiet", "all", "--", f"results/{tree}/{CLOUD}"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if path:
        (project / path).write_text(text, encoding="utf-8")
    if done.returncode:
        raise StageError(f"{name} {factor}: {done.stdout[-2000:]}{done.stderr[-2000:]}", tree=tree)
    return sum(
        float(row["cpu_time"])
        for table in here.glob("benchmarks/*/*.tsv")
        for row in csv.DictReader(table.open(encoding="utf-8"), delimiter="\t")
    )


def _row(change, spent, wood):
    told = {"number": "as it is", "becomes": ""}
    if change:
        told = {"number": change[1], "becomes": change[4].partition(" = ")[2]}
    told["cpu_s"] = round(spent, 1)
    for label in ("all", "branch_5_10mm", "branch_below_5mm"):
        for tolerance in ("5mm", "10mm"):
            told[f"{label} {tolerance}"] = round(wood[label][tolerance]["f1"] or 0.0, 4)
    return told


if __name__ == "__main__":
    run(main, stage_parser(__doc__, main), globals().get("snakemake"))
