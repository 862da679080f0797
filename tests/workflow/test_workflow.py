"""What the batch promises, each proved by real Snakemake runs on small ready clouds."""

import csv
import time

import pytest
from workspace import Workspace, copy_project, kill_group

STAGES = [
    "import_segmented_cloud",
    "contract_cloud",
    "extract_graph",
    "measure_traits",
    "report_tree",
]


def of_tree(name, *stages):
    return {(stage, name) for stage in stages}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A batch of two labelled clouds, run once; later tests edit it step by step, in order."""
    workspace = Workspace(tmp_path_factory.mktemp("batch") / "work")
    workspace.add_cloud("a")
    workspace.add_cloud("b", seed=1)
    workspace.configure({}, "b.yaml")
    workspace.table("tree | cloud | config", "a | a.ply | ", "b | b.ply | config/b.yaml")
    workspace.first = workspace.ran()
    return workspace


def test_a_batch_elsewhere_runs_whole(finished):
    assert finished.first == {
        *of_tree("a", *STAGES),
        *of_tree("b", *STAGES),
        ("summarise_batch", ""),
    }
    for tree in "ab":
        folder = finished.folder / "results" / tree
        names = "segmented.ply contracted.ply skeleton.graphml skeleton.ply topology.graphml "
        names += "skeleton.swc traits.json branches.csv report.html"
        for name in names.split():
            assert (folder / name).stat().st_size > 0, name
        for stage in STAGES:
            assert (finished.folder / "logs" / stage / f"{tree}.log").exists()
    assert not (finished.project / "results" / "a").exists()


def test_a_second_run_has_nothing_to_do(finished):
    assert "Nothing to be done" in finished.run()


def test_editing_one_parameter_reruns_its_stage_and_what_follows(finished):
    finished.configure({"graph": {"spacing_m": 0.017}})
    assert finished.ran() == {
        *of_tree("a", *STAGES[2:]),
        *of_tree("b", *STAGES[2:]),
        ("summarise_batch", ""),
    }
    assert "Nothing to be done" in finished.run()


def test_a_trees_own_config_concerns_that_tree_alone(finished):
    finished.configure({"contract": {"max_iterations": 5}}, "b.yaml")
    assert finished.ran() == {*of_tree("b", *STAGES[1:]), ("summarise_batch", "")}


def test_the_command_line_wins_over_the_trees_own_config(finished):
    printed = finished.run("--dry-run", "--config", "contract={max_iterations: '5'}")
    assert "a: contract" in printed
    assert "b: contract" not in printed


def test_adding_a_tree_computes_that_tree_alone(finished):
    finished.add_cloud("c", seed=2)
    finished.table(
        "tree | cloud | config", "a | a.ply | ", "b | b.ply | config/b.yaml", "c | c.ply | "
    )
    assert finished.ran() == {*of_tree("c", *STAGES), ("summarise_batch", "")}


def test_a_single_stage_can_be_forced(finished):
    ran = finished.ran("--forcerun", "extract_graph", "--until", "extract_graph")
    assert ran == {("extract_graph", name) for name in "abc"}


def test_one_bad_tree_leaves_the_others_whole(tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("good")
    (workspace.folder / "broken.ply").write_text("not a cloud")
    workspace.table("tree | cloud", "good | good.ply", "broken | broken.ply", "gone | gone.ply")
    printed = workspace.run(fails=True)
    for tree, file, cause in (
        ("broken", "broken.ply", "not a PLY"),
        ("gone", "gone.ply", "missing"),
    ):
        (line,) = [line for line in printed.splitlines() if line.startswith(f"ERROR tree={tree}")]
        assert file in line
        assert cause in line
    assert (workspace.folder / "results/good/report.html").exists()
    with open(workspace.folder / "results/traits.csv", newline="") as stream:
        rows = {row["tree"]: row for row in csv.DictReader(stream)}
    assert set(rows) == {"good", "broken", "gone"}
    assert "not a PLY" in str(rows["broken"])
    assert "import_cloud" in str(rows["broken"])
    page = (workspace.folder / "results/summary.html").read_text()
    assert "not a PLY" in page

    # once mended, only the bad trees are computed
    workspace.add_cloud("broken", seed=1)
    workspace.add_cloud("gone", seed=2)
    expected = {*of_tree("broken", *STAGES), *of_tree("gone", *STAGES), ("summarise_batch", "")}
    assert workspace.ran() == expected
    assert "Nothing to be done" in workspace.run()
    assert "not a PLY" not in (workspace.folder / "results/traits.csv").read_text()


def test_a_killed_run_resumes_without_redoing_finished_stages(tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    workspace.table("tree | cloud", "a | a.ply")
    process = workspace.start()
    contracted = workspace.folder / "results/a/contracted.ply"
    graph = workspace.folder / "logs/extract_graph/a.log"
    deadline = time.monotonic() + 120
    while not graph.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    kill_group(process)
    assert contracted.exists()
    stamp = contracted.stat().st_mtime_ns
    ran = workspace.ran()
    assert ("import_segmented_cloud", "a") not in ran
    assert ("contract_cloud", "a") not in ran
    assert ("report_tree", "a") in ran
    assert contracted.stat().st_mtime_ns == stamp
    assert "Nothing to be done" in workspace.run()


def test_editing_a_library_module_reruns_the_stages_that_use_it(tmp_path):
    (tmp_path / "project").mkdir()
    project = copy_project(tmp_path / "project")
    workspace = Workspace(tmp_path / "work", project)
    workspace.add_cloud("a")
    workspace.table("tree | cloud", "a | a.ply")
    workspace.run()
    module = project / "scripts/cherrypicker/contraction/contract_points.py"
    module.write_text(module.read_text() + "\n# edited\n")
    ran = workspace.ran()
    assert ("contract_cloud", "a") in ran
    assert ("import_segmented_cloud", "a") not in ran
    assert "Nothing to be done" in workspace.run()


def test_a_typo_in_the_config_stops_the_batch_and_names_the_key(tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.table("tree | cloud")
    workspace.configure({"contract": {"metod": "lbc"}})
    printed = workspace.run(fails=True)
    assert "contract.metod" in printed
    assert "contract.method" in printed
