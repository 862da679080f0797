"""The laboratory's rules: each target finds its scripts, environments and inputs."""

from workspace import Workspace

TARGETS = [
    *("orchard", "orchard_skeletons", "benchmark_skeleton", "benchmark_traits"),
    *("benchmark_trunks", "benchmark_series", "error_budget", "fit_intervals", "train_sky"),
    "train_segmentation",
]


def test_every_target_of_the_laboratory_can_be_planned(tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    workspace.table("tree | cloud", "a | a.ply")
    assert "This was a dry-run" in workspace.run("--dry-run", *TARGETS)
