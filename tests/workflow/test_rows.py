"""A scan of several trees, as a user runs it: its trees are trees like any other."""

import csv

import numpy as np
import pytest
from workspace import PROJECT, Workspace, small_tree

from cherrypicker.batch.batch import read_batch
from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml, read_json
from cherrypicker.pointcloud import PointCloud, read_cloud, write_cloud

FEET = ((0.0, 0.0), (1.4, 0.0), (2.8, 0.1))


@pytest.fixture(scope="module")
def row(tmp_path_factory):
    """Three small trees in one labelled cloud."""
    space = Workspace(tmp_path_factory.mktemp("row") / "work")
    trees = [small_tree(seed) for seed in range(len(FEET))]
    points = [tree.points + [*foot, 0.0] for tree, foot in zip(trees, FEET)]
    labels = np.concatenate([tree["label"] for tree in trees])
    write_cloud(space.folder / "row.ply", PointCloud(np.vstack(points), fields={"label": labels}))
    space.table("tree | cloud | date | series", "row | row.ply | 2026-02-11 | ")
    return space


def planned(space):
    """(rule, tree) of what a run would do, each with how often."""
    table = space.run("--dry-run").split("Job stats:")[1].split("Reasons:")[0]
    rows = [line.split() for line in table.splitlines()]
    return {line[0]: int(line[1]) for line in rows if len(line) == 2 and line[1].isdigit()}


def test_a_list_makes_a_tree_a_place_and_all_every_tree_that_stands_there(row):
    row.configure({"crop": {"target_xy": [[2.8, 0.0], [0.0, 0.0]]}})
    assert {"find_trees": 1, "split_scan": 2, "report_tree": 2}.items() <= planned(row).items()
    row.configure({"crop": {"target_xy": "all"}})
    assert "report_tree" not in planned(row)  # nobody has looked yet
    done = row.ran("results/row_2/segmented.ply")
    assert done == {
        ("import_segmented_cloud", "row"),
        ("grow_limbs", "row"),
        ("find_trees", "row"),
        ("split_scan", "row_2"),
    }
    assert [one["tree"] for one in read_json(row.folder / "results/row/trees.json")["trees"]] == [
        "row_1", "row_2", "row_3",
    ]  # fmt: skip
    own = read_cloud(row.folder / "results/row_2/segmented.ply")
    np.testing.assert_allclose(own.points[:, :2].mean(axis=0), FEET[1], atol=0.15)
    assert np.abs(own.points[:, 0] - FEET[1][0]).max() < 0.7
    place = read_json(row.folder / "results/row_2/tree.json")
    np.testing.assert_allclose(place["target_xy"], FEET[1], atol=0.03)
    assert len(place["neighbours_xy"]) == 2
    assert {"split_scan": 2, "contract_cloud": 3, "report_tree": 3}.items() <= planned(row).items()


@pytest.mark.parametrize(
    "given, rows, told, key",
    [
        (
            [[1, 2], 3],
            [],
            "[[1, 2], 3] is neither a pair of numbers",
            "crop.target_xy",
        ),
        ("every", [], "crop.target_xy: 'every' is neither a pair of numbers", "crop.target_xy"),
        ("all", ["ROW_2\trow.ply"], "bears the name of a tree of the scan 'row'", "tree"),
        ("all", ["b\trow.ply\ts"], "tree 'b': the trees of a series must keep", "crop.target_xy"),
    ],
)
def test_what_makes_no_sense_is_refused_at_the_start(tmp_path, monkeypatch, given, rows, told, key):
    monkeypatch.chdir(tmp_path)
    table = ["tree\tcloud\tseries", "row\trow.ply", *rows]
    (tmp_path / "trees.tsv").write_text("\n".join(table), encoding="utf-8")
    schema = load_yaml(PROJECT / "workflow/schemas/config.schema.yaml")
    with pytest.raises(StageError) as caught:
        read_batch(schema, {"trees": "trees.tsv", "crop": {"target_xy": given}})
    assert told in caught.value.cause
    assert caught.value.key == key and caught.value.file


def test_a_listed_tree_has_its_scans_row_and_config(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    table = "tree\tphotos\tdate\tseries\nrow\tp\t2026-02-11\tfield\nlone\tq\t\t\n"
    (tmp_path / "trees.tsv").write_text(table, encoding="utf-8")
    schema = load_yaml(PROJECT / "workflow/schemas/config.schema.yaml")
    config = {"trees": "trees.tsv", "crop": {"target_xy": [["1", "2"], [3, 4]]}}
    batch = read_batch(schema, config)
    assert batch.places["row"] == [[1, 2], [3, 4]] and batch.names("lone") == ["lone_1", "lone_2"]
    second = batch.row("row_2")
    assert (second.tree, second.photos, second.series) == ("row_2", "p", "field_2")
    assert batch.settings_for("row_2")["crop"]["target_xy"] is None
    assert [batch.has(name) for name in ("row", "row_2", "row_3")] == [False, True, False]
    assert [row.tree for row in batch.rows_to_tell()][:2] == ["row_1", "row_2"]
    status = tmp_path / "logs/status/row"
    status.mkdir(parents=True)
    (status / "segment_cloud.json").write_text("{}", encoding="utf-8")
    assert batch.rows_to_tell()[0].tree == "row"  # a scan that failed is told


def test_a_scan_that_failed_is_told_beside_the_other_trees(tmp_path):
    space = Workspace(tmp_path / "work")
    space.configure({"crop": {"target_xy": "all"}}, "row.yaml")
    space.table("tree | cloud | config", "row | gone.ply | config/row.yaml", "lone | gone.ply | ")
    space.run(fails=True)
    with open(space.folder / "results/traits.csv", newline="") as stream:
        told = {row["tree"]: row["failed_stage"] for row in csv.DictReader(stream)}
    assert told == {"row": "import_cloud", "lone": "import_cloud"}
