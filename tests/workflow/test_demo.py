"""The demo's results against the ground truth of its scenes (after ``make demo``)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cherrypicker.batch.trees import read_trees
from cherrypicker_lab.evaluation import evaluate, missed_bars

PROJECT = Path(__file__).resolve().parents[2]
RESULTS = Path(os.environ.get("CHERRYPICKER_RESULTS", PROJECT / "results"))
TABLE = PROJECT / "config" / "trees.tsv"

pytestmark = pytest.mark.demo


def demo_trees():
    """Rows of the shipped table whose photos lie beside a ``truth`` folder."""
    if not TABLE.is_file():
        return []
    rows = [row for row in read_trees(TABLE) if row.is_photo_scan]
    scenes = {row.tree: (PROJECT / row.photos).parent for row in rows}
    return [(tree, scene) for tree, scene in scenes.items() if (scene / "truth").is_dir()]


def test_the_batch_is_two_trees():
    assert len(demo_trees()) == 2


@pytest.mark.parametrize(("tree", "scene"), demo_trees())
def test_demo_tree_meets_every_bar(tree, scene):
    folder = RESULTS / tree
    if not (folder / "traits.json").is_file():
        pytest.skip(f"{folder} has no results: run `make demo` first")
    report = evaluate(folder, scene / "truth")
    missed = [f"{bar.what}: {report.get(bar.name)}" for bar in missed_bars(report)]
    assert not missed, "; ".join(missed)
    assert (folder / "report.html").is_file()


@pytest.mark.parametrize(("tree", "scene"), demo_trees())
def test_the_command_agrees(tree, scene, tmp_path):
    folder = RESULTS / tree
    if not (folder / "traits.json").is_file():
        pytest.skip(f"{folder} has no results: run `make demo` first")
    command = [sys.executable, PROJECT / "scripts/lab/evaluate_scene.py", "--check"]
    command += ["--results", folder, "--truth", scene / "truth", "--output", tmp_path / "out.json"]
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "out.json").is_file()
