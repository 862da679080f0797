"""The method as published, by Snakemake: from labels in the quick suite, from photos outside it."""

import networkx as nx
import pytest
from workspace import PROJECT, Workspace

from cherrypicker.batch.trees import read_trees
from cherrypicker.files import read_json


def assert_as_published(folder, height_m, within):
    """The files of a tree say how they were made, and are those of a tree."""
    contraction = read_json(folder / "contract.json")
    assert contraction["method"] == "slbc" and len(contraction["mass_ratio"]) > 1
    assert contraction["voxel_size"] >= 0.015
    graph = nx.read_graphml(folder / "skeleton.graphml")
    assert nx.is_tree(graph) and len(graph) > 20
    topology = nx.read_graphml(folder / "topology.graphml")
    kinds = [kind for _, kind in topology.nodes(data="kind")]
    assert kinds.count("junction") >= 3 and kinds.count("tip") >= 4
    traits = read_json(folder / "traits.json")
    assert traits["height_m"] == pytest.approx(height_m, rel=within)
    assert (folder / "report.html").is_file()


def test_a_labelled_cloud_goes_the_papers_way_to_its_traits(tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    workspace.table("tree | cloud", "a | a.ply")
    workspace.configure({"method": "paper", "skeleton": {"max_iterations": 19}})
    printed = workspace.run()
    folder = workspace.folder / "results/a"
    assert_as_published(folder, 1.2, 0.05)
    why = "skeleton.max_iterations: 19 does nothing: it is read under skeleton.method: slbc or lbc"
    assert why not in printed
    stages = {"grow_limbs", "contract_cloud", "extract_graph", "measure_traits", "report_tree"}
    assert {
        rule for rule, tree in workspace.planned("--config", "method=default") if tree
    } == stages
    assert workspace.printed.count(why) == 1
    later = stages - {"grow_limbs"}
    old = ("--config", "contract={method: lbc}")
    assert {rule for rule, tree in workspace.planned(*old) if tree} == later
    assert "contract.method: lbc is now skeleton.method: lbc" in workspace.printed


@pytest.mark.slow
def test_both_demo_trees_go_the_papers_way_from_their_photos(tmp_path):
    """About an hour on two cores."""
    rows = read_trees(PROJECT / "config/trees.tsv")
    workspace = Workspace(tmp_path / "work")
    workspace.table(
        "tree | photos | marker_dictionary | marker_sides_m",
        *(
            f"{row.tree} | {PROJECT / row.photos} | {row.marker_dictionary} | {row.marker_sides_m}"
            for row in rows
        ),
    )
    workspace.configure({"method": "paper"})
    printed = workspace.run(limit_s=4 * 3600)
    assert "train_segment.graph: dynamic trains the paper's" in printed
    assert len(rows) == 2
    for row in rows:
        folder = workspace.folder / "results" / row.tree
        truth = read_json((PROJECT / row.photos).parent / "truth/traits.json")
        assert_as_published(folder, truth["height_m"], 0.15)
        align = read_json(folder / "align.json")
        assert [align[name] for name in ("plane", "up_from", "flip")] == [
            "ransac",
            "ground",
            "mass",
        ]
        assert read_json(folder / "crop.json")["source"] == "cameras"
        denoised = read_json(folder / "denoise.json")
        assert denoised["n_kept_by_photos"] == denoised["n_kept_twigs"] == 0
        for marker in read_json(folder / "scale.json")["markers"]:
            mean = sum(marker["side_lengths"]) / 4
            assert marker["scale"] == pytest.approx(marker["side_m"] / mean)
