"""`snakemake orchard` as a user runs it."""

import json

from workspace import Workspace


def test_the_orchard_leaves_its_own_files_alone_and_nothing_to_do(tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    workspace.table("tree | cloud", "a | a.ply")
    orchard = {
        "n_scenes": 1, "seed": 3, "n_points": 2000, "surface_points": 2000, "n_photos": 8,
        "photo_size_px": 320, "chosen": {"net": "over", "ground": "gravel", "wind_m": 0.01},
    }  # fmt: skip
    workspace.configure({"orchard": orchard})
    workspace.run("orchard")
    results = workspace.folder / "results"
    assert [path.name for path in results.iterdir()] == ["orchard"]
    scene = json.loads((results / "orchard/scenes/3/truth/scene.json").read_text())
    assert {k: scene["options"][k] for k in ("net", "ground", "wind")} == {
        "net": "over", "ground": "gravel", "wind": 0.01,
    }  # fmt: skip
    assert "Nothing to be done" in workspace.run("orchard")
