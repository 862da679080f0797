"""What the batch promises, each proved by Snakemake itself on small ready clouds."""

import csv
import re

import pytest
from workspace import PROJECT, Workspace, project_with_own

from cherrypicker.batch.config import lookup, resolve_config
from cherrypicker.files import load_yaml

SCHEMA = PROJECT / "workflow/schemas/config.schema.yaml"
STAGES = [
    "import_segmented_cloud",
    "grow_limbs",
    "contract_cloud",
    "extract_graph",
    "measure_traits",
    "report_tree",
]
SUMMARY = ("summarise_batch", "")
MODULE = "scripts/cherrypicker/contraction/contract_points.py"
PAIR = ["tree | cloud | config", "a | a.ply | ", "b | b.ply | config/b.yaml"]


def of_tree(name, *stages):
    return {(stage, name) for stage in stages}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A batch of two labelled clouds, run once; later tests edit it step by step, in order."""
    workspace = Workspace(tmp_path_factory.mktemp("batch") / "work")
    workspace.add_cloud("a")
    workspace.add_cloud("b", seed=1)
    workspace.configure({}, "b.yaml")
    workspace.table(*PAIR)
    workspace.first = workspace.ran()
    return workspace


def test_a_batch_elsewhere_runs_whole(finished):
    assert finished.first == {*of_tree("a", *STAGES), *of_tree("b", *STAGES), SUMMARY}
    for tree in "ab":
        folder = finished.folder / "results" / tree
        names = "segmented.ply contracted.ply skeleton.graphml skeleton.ply topology.graphml "
        names += "skeleton.swc traits.json branches.csv limbs.csv report.html"
        for name in names.split():
            assert (folder / name).stat().st_size > 0, name
        for stage in STAGES:
            assert (finished.folder / "logs" / stage / f"{tree}.log").exists()
    assert not (finished.project / "results" / "a").exists()


def test_a_second_run_has_nothing_to_do(finished):
    assert "Nothing to be done" in finished.run()


@pytest.fixture
def clone(finished, tmp_path):
    """The batch goes on with a project elsewhere, whose module is its own."""
    finished.project = project_with_own(MODULE, tmp_path / "clone")
    yield finished.project
    finished.project = PROJECT


def test_editing_a_library_module_reruns_the_stages_that_use_it(finished, clone):
    module = clone / MODULE
    module.write_text(module.read_text() + "\n# edited\n")
    planned = finished.planned()
    assert planned == {*of_tree("a", *STAGES[2:]), *of_tree("b", *STAGES[2:]), SUMMARY}


def test_another_clone_reruns_nothing(finished, clone):
    for file in (MODULE, "scripts/measure_traits.py"):
        (clone / file).touch()
    assert "Nothing to be done" in finished.run(), "their content is the same"


def test_editing_one_parameter_reruns_its_stage_and_what_follows(finished):
    """That they run and leave nothing to do is seen in test_workflow_photos."""
    finished.configure({"graph": {"spacing_m": 0.017}})
    assert finished.planned() == {*of_tree("a", *STAGES[3:]), *of_tree("b", *STAGES[3:]), SUMMARY}
    finished.configure({})


def test_a_trees_own_config_concerns_that_tree_alone_and_the_command_line_wins(finished):
    finished.configure({"contract": {"voxel_size_m": 0.006}}, "b.yaml")
    assert finished.planned() == {*of_tree("b", *STAGES[1:]), SUMMARY}
    default = lookup(resolve_config(load_yaml(SCHEMA), {}), "contract.voxel_size_m")
    assert finished.planned("--config", f"contract={{voxel_size_m: '{default}'}}") == set()
    finished.configure({}, "b.yaml")


def test_a_single_stage_can_be_forced(finished):
    stage = "extract_graph"
    printed = finished.run("--dry-run", "--forcerun", stage, "--until", stage)
    assert set(re.findall(r"(?m)^(\w+) +(\d+)$", printed)) == {(stage, "2"), ("total", "2")}


def test_hand_measurements_concern_their_tree_alone(finished):
    table = finished.folder / "config/measures.csv"
    one = "tree,trait,value,unit,who\na,height,118,cm,AB\n"
    table.write_text(one + "elsewhere,height,2,m,AB\n")
    assert finished.ran() == {*of_tree("a", "compare_measures", "report_tree"), SUMMARY}
    assert "line 3 of config/measures.csv: no tree 'elsewhere'" in finished.printed
    with open(finished.folder / "results/accuracy.csv", newline="") as stream:
        ours = next(csv.DictReader(stream))
    assert (ours["trait"], ours["n"]) == ("height_m", "1")
    assert abs(float(ours["bias"])) < 0.1
    assert "118 cm" in (finished.folder / "results/a/report.html").read_text()
    table.write_text(one + "b,height,1.2,m,AB\n")
    assert finished.planned() == {*of_tree("b", "compare_measures", "report_tree"), SUMMARY}
    table.write_text(one + "b,height,1.2,kg,AB\n")
    assert "line 3, tree 'b': 'kg' is no unit of height_m" in finished.run(fails=True)
    table.write_text(one)


def test_a_bad_tree_is_told_and_the_others_stay(finished):
    (finished.folder / "broken.ply").write_text("not a cloud")
    finished.table(*PAIR, "broken | broken.ply | ", "gone | gone.ply | ")
    assert finished.ran(fails=True) == {SUMMARY}  # of those that are finished
    for tree, cause in (("broken", "not a PLY"), ("gone", "missing")):
        (line,) = [line for line in finished.printed.splitlines() if f"ERROR tree={tree}" in line]
        assert f"{tree}.ply" in line
        assert cause in line
    with open(finished.folder / "results/traits.csv", newline="") as stream:
        rows = {row["tree"]: row for row in csv.DictReader(stream)}
    assert [rows[tree]["status"] for tree in "ab"] == ["done", "done"]
    for tree in ("broken", "gone"):
        assert (rows[tree]["status"], rows[tree]["failed_stage"]) == ("failed", "import_cloud")
    assert "not a PLY" in rows["broken"]["cause"]
    assert "not a PLY" in (finished.folder / "results/summary.html").read_text()


def test_a_new_or_mended_tree_is_computed_alone(finished):
    finished.add_cloud("broken", seed=2)
    finished.table(*PAIR, "broken | broken.ply | ")
    assert finished.ran() == {*of_tree("broken", *STAGES), SUMMARY}
    assert finished.planned() == set()
    assert "not a PLY" not in (finished.folder / "results/traits.csv").read_text()


def test_a_series_of_two_scans_is_compared_and_one_of_one_is_not(finished):
    assert "compare_series" not in finished.run("--dry-run", "--quiet")
    finished.table(
        "tree | cloud | config | series | date",
        "a | a.ply |  | row 1 | 2025-02-01",
        "b | b.ply | config/b.yaml | row 1 | 2026-02-01",
        "broken | broken.ply |  | row 2 | 2026-02-01",
    )
    printed = finished.run("--dry-run")
    assert "row_1: compare the dates of the tree" in printed
    assert "row_2" not in printed


def test_of_a_series_with_a_failure_the_finished_scans_are_compared(finished):
    finished.table(
        "tree | cloud | config | series | date",
        "a | a.ply |  | row 1 | 2025-02-01",
        "b | b.ply | config/b.yaml | row 1 | 2026-02-01",
        "lost | gone.ply |  | row 1 | 2027-02-01",
    )
    finished.run(fails=True)
    page = finished.folder / "results/series/row_1/report.html"
    assert "lost" in page.read_text() and "it is not finished" in page.read_text()
    assert "series/row_1/report.html" in (finished.folder / "results/summary.html").read_text()
