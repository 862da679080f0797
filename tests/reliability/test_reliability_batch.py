"""One batch with a bad tree of every kind: each is told its reason, the good ones are finished."""

import csv
import re

import numpy as np
import pytest
from fuzz_clouds import READERS
from reliability_scene import odd_clouds, write_small_cloud
from sfm_scene import write_orbit
from workspace import Workspace

# One a stage that refuses; what else the import refuses stands in test_reliability_clouds
CLOUDS = ["nan", "points_1", "bare_3", "same"]
ODD_PATH = "Bäume & Blüten {1}/名 'x' $a %s <b>.ply"
HEADER = "tree | cloud | photos | scale | marker_dictionary | marker_sides_m | date | series"
LAS = next(reader for reader in READERS if reader.name == "las")
SIDES = {
    "m_missing": ("", "marker_dictionary and marker_sides_m are empty"),
    "m_cm": ("7:20", "sides are given in metres"),
}


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    """The batch, run once; ``told`` holds what each bad tree is expected to say."""
    folder = tmp_path_factory.mktemp("Prüfstand für Bäume") / "work"
    workspace = Workspace(folder)
    write_small_cloud(folder / ODD_PATH)
    told = {name: (*said, f"{name}.ply") for name, said in odd_clouds(folder).items()}
    (folder / "photos").mkdir()
    paths, _ = write_orbit(folder / "photos", 3)
    paths[1].write_bytes(paths[1].read_bytes()[:2000])
    rows = [
        HEADER,
        f"good | {ODD_PATH} |  |  |  |  | 2026-03-01 | row 1",
        *(f"{name} | {name}.ply |  |  |  |  |  | " for name in CLOUDS),
        "p_cut |  | photos | none |  |  |  | ",
        "gone | nowhere.ply |  |  |  |  |  | ",
        "las_cut | cut.las |  |  |  |  |  | ",
        "p_noise |  | noise | none |  |  |  | ",
    ]
    write_noise(folder)
    told["las_cut"] = ("import_cloud", "promises", "cut.las")
    told["p_noise"] = ("prepare_photos", "cannot be", "noise")
    told["p_cut"] = ("extract_features", "unreadable", paths[1].name)
    told["gone"] = ("import_cloud", "missing", "nowhere.ply")
    for name, (sides, reason) in SIDES.items():
        dictionary = "DICT_4X4_50" if sides else ""
        rows.append(f"{name} |  | photos |  | {dictionary} | {sides} |  | ")
        told[name] = ("extract_features", reason, "trees.tsv")
    workspace.table(*rows)
    workspace.order = [row.split(" | ")[0] for row in rows[1:]]
    workspace.printed = workspace.run(fails=True)
    workspace.told = told
    return workspace


def write_noise(folder):
    """A LAS file of which most is missing, and photos and a film of bytes of chance."""
    (folder / "las").mkdir()
    path = next(path for path in LAS.make(folder / "las") if path.suffix == ".las")
    (folder / "cut.las").write_bytes(path.read_bytes()[:600])
    (folder / "noise").mkdir()
    rng = np.random.default_rng(0)
    for name in ("a.jpg", "b.heic", "c.mp4", "d.dng"):
        (folder / "noise" / name).write_bytes(rng.bytes(3000))


def summary_of(batch):
    with open(batch.folder / "results/traits.csv", newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_a_good_tree_is_finished(batch):
    assert (batch.folder / "results/good/report.html").stat().st_size > 0
    (row,) = [row for row in summary_of(batch) if row["tree"] == "good"]
    assert row["status"] == "done"
    assert 1.0 < float(row["height_m"]) < 1.4


@pytest.mark.parametrize("tree", [*CLOUDS, "p_cut", "gone", "las_cut", "p_noise", *SIDES])
def test_a_bad_tree_is_told_its_reason(batch, tree):
    stage, reason, file = batch.told[tree]
    lines = [line for line in batch.printed.splitlines() if line.startswith(f"ERROR tree={tree} ")]
    told = [line for line in lines if f"rule={stage}:" in line]
    assert len(told) == 1, f"{lines or 'no line'} for {tree} in\n{batch.printed}"
    line = told[0]
    assert reason in line
    assert "unexpected" not in line
    assert file in line or stage not in (
        "import_cloud",
        "import_segmented_cloud",
        "extract_features",
    )
    (row,) = [row for row in summary_of(batch) if row["tree"] == tree]
    assert row["status"] == "failed"
    assert row["failed_stage"] in {stage, "segment_sky"}
    assert reason in row["cause"] or row["failed_stage"] != stage


def test_nothing_runs_for_a_tree_whose_marker_columns_cannot_work(batch):
    for tree in SIDES:
        assert not list((batch.folder / "results").glob(f"{tree}/*"))
        assert not list((batch.folder / "benchmarks").glob(f"*/{tree}.tsv"))


def test_table_and_page_list_the_trees_in_the_tables_order(batch):
    assert [row["tree"] for row in summary_of(batch)] == batch.order
    page = (batch.folder / "results/summary.html").read_text()
    bad = [tree for tree in batch.order if tree != "good"]
    places = [re.search(rf'<th scope="row">.*[>"]{tree}<', page).start() for tree in bad]
    assert places == sorted(places)
