"""The table of trees and the config: every slip is named, with the line and what to write."""

import pytest
import yaml
from reliability_scene import MARKUP
from sfm_scene import write_orbit
from sound_tree import flags_of
from test_marker_scale import aligned_scene
from workspace import Workspace

from cherrypicker.batch.batch import read_batch
from cherrypicker.batch.config import read_config_file, resolve_config
from cherrypicker.batch.trees import read_trees
from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml
from cherrypicker.intake.clouds import HeightOptions, check_height
from cherrypicker.markers.references import check_scale, parse_marker_sides
from cherrypicker.markers.scale_scene import scale_scene
from cherrypicker.traits.intervals import Estimate
from cherrypicker.traits.reports import Reports


@pytest.fixture
def refused(tmp_path):
    """Write a table; return the refusal as the user reads it."""

    def refuse(content):
        path = tmp_path / "trees.tsv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(StageError) as caught:
            read_trees(path)
        assert caught.value.file == str(path)
        return caught.value.describe()

    return refuse


@pytest.mark.parametrize(
    "name", ["../x", "a/b", "/etc", "a\\b", "~", "a b", ".", "..", ".hidden", "-", "a:b", MARKUP]
)
def test_an_id_that_is_a_path_or_markup_is_refused(refused, name, tmp_path):
    if name == "-":
        (tmp_path / "t.tsv").write_text("tree\tcloud\n-\ta.ply\n")
        assert read_trees(tmp_path / "t.tsv")[0].tree == "-"
        return
    assert "line 2" in refused(f"tree\tcloud\n{name}\ta.ply\n")


def test_ids_that_differ_by_case_alone_would_share_a_folder_on_some_disks(refused):
    assert "stands twice" in refused("tree\tcloud\nApple\ta.ply\napple\tb.ply\n")


@pytest.mark.parametrize(
    ("header", "hint"),
    [
        ("tree\tclod", "did you mean 'cloud'?"),
        ("Tree\tcloud", "did you mean 'tree'?"),
        ("tree\tcloud\tmarker_side_m", "did you mean 'marker_sides_m'?"),
        ("tree,cloud", "separated by tabs"),
        ("tree\tcloud\tcloud", "named twice"),
        ("cloud\tscale", "'tree' is missing"),
        ("tree\tscale", "'photos' and 'cloud'"),
    ],
)
def test_unknown_double_and_missing_columns(refused, header, hint):
    assert hint in refused(f"{header}\na\tb.ply\n")


@pytest.mark.parametrize("mark", ["", "\ufeff"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_byte_order_mark_and_line_ends_of_any_system(tmp_path, mark, end):
    text = mark + end.join(["tree\tcloud\tseries", "a\ta.ply\tRow 1", "b\tb.ply\t", ""])
    (tmp_path / "t.tsv").write_bytes(text.encode())
    first, second = read_trees(tmp_path / "t.tsv")
    assert (first.tree, first.series, second.tree, second.series) == ("a", "Row 1", "b", "")


@pytest.mark.parametrize("content", ["tree\tcloud\nä\ta.ply\n".encode("latin-1"), b"\xff\xfet\0"])
def test_a_table_in_another_encoding_is_told(refused, content):
    assert "not UTF-8" in refused(content)


@pytest.mark.parametrize(
    ("dictionary", "sides", "reason"),
    [
        ("", "", "marker_dictionary and marker_sides_m are empty"),
        ("DICT_4X4_50", "", "marker_sides_m is empty"),
        ("", "7:0.2", "marker_dictionary is empty"),
        ("DICT_4X4_50", "7:0.2,7:0.2", "marker 7 stands twice"),
        ("DICT_4X4_50", "7:0", "sides are given in metres"),
        ("DICT_4X4_50", "7:20", "sides are given in metres"),
        ("DICT_4X4_50", "7:200", "sides are given in metres"),
        ("DICT_4X4_50", "50:0.2", "markers 0 to 49"),
        ("DICT_4X4_5O", "7:0.2", "did you mean 'DICT_4X4_50'"),
    ],
)
def test_marker_columns_are_judged_without_a_photo(dictionary, sides, reason):
    with pytest.raises(StageError, match=reason) as caught:
        check_scale("", "marker", dictionary, sides)
    assert "trees.tsv" in caught.value.key
    assert check_scale("none", "marker", dictionary, sides) == ({}, [])


def test_a_side_in_centimetres_is_caught_whatever_its_size():
    """Above 2 m by its number alone; below, by how high the tree would be."""
    for side_m in (0.05, 0.10, 0.25):
        with pytest.raises(StageError, match="in metres"):
            parse_marker_sides(f"7:{100 * side_m:g}")
    assert parse_marker_sides("7:1.5") == {7: 1.5}  # a marker of 1.5 cm, or one of 1.5 m


def test_the_trees_height_questions_a_scale():
    cloud, poses, crop = aligned_scene()  # 3 units tall
    for scale in (100.0, 0.01):
        report = {"mode": "marker", "scale": scale, "unit": "m"}
        with pytest.raises(StageError, match="m high, and a tree of .* is not believed"):
            check_height(scale_scene(cloud, poses, report, crop)[0], HeightOptions(), "scale")
    for height in (0.03, 30.0):
        (flag,) = flags_of(Reports(), height=Estimate(height))
        assert flag.startswith("odd_height") and "marker_sides_m" in flag
    assert flags_of(Reports(), height=Estimate(2.5)) == []
    assert "odd_height" not in str(flags_of(Reports(), unit="arbitrary", height=Estimate(900.0)))


@pytest.fixture(scope="module")
def schema(project):
    return load_yaml(project / "workflow/schemas/config.schema.yaml")


@pytest.mark.parametrize(
    ("config", "wrong", "right"),
    [
        ({"mvz": {}}, "mvz", "mvs"),
        ({"skeleton": {"metod": "lbc"}}, "skeleton.metod", "skeleton.method"),
        ({"scale": {"Mode": "none"}}, "scale.Mode", "scale.mode"),
        ({"report": {"viewer_point": 5}}, "report.viewer_point", "report.viewer_points"),
    ],
)
def test_a_config_typo_is_named_with_the_nearest_key(schema, config, wrong, right):
    with pytest.raises(StageError, match=f"'{wrong}'.*did you mean '{right}'"):
        resolve_config(schema, config, source="config/config.yaml")


def test_a_typo_names_every_config_file_that_was_given(schema):
    with pytest.raises(StageError, match=r"file: config/config\.yaml, orchard\.yaml; change: mvz"):
        read_batch(schema, {"mvz": {}}, files=["orchard.yaml"])


def test_a_config_executes_nothing(tmp_path):
    executed = tmp_path / "executed"
    path = tmp_path / "a.yaml"
    path.write_text(f"seed: !!python/object/apply:os.mkdir [{executed}]\n")
    with pytest.raises(StageError, match="no valid YAML"):
        read_config_file(path)
    assert not executed.exists()
    yaml.unsafe_load(path.read_text())
    assert executed.exists(), "the payload of this test is dead"


@pytest.fixture
def batch(tmp_path):
    workspace = Workspace(tmp_path / "work")
    workspace.add_cloud("a")
    return workspace


@pytest.mark.parametrize(
    ("rows", "config", "reason"),
    [
        (["tree | cloud", "a | a.ply", "a | a.ply"], {}, "tree 'a' stands twice"),
        (["tree | cloud", "a | a.ply"], {"skeleton": {"metod": "lbc"}}, "'skeleton.method'"),
    ],
)
def test_a_table_that_cannot_be_understood_stops_the_batch_before_it_starts(
    batch, rows, config, reason
):
    """Which tree is meant is not known, so that none is touched; nothing that was there is lost."""
    (batch.folder / "results/a").mkdir(parents=True)
    (batch.folder / "results/a/traits.json").write_text("{}")
    batch.table(*rows)
    batch.configure(config)
    printed = batch.run("--dry-run", fails=True)
    assert reason in printed
    assert "Traceback" not in printed
    assert [path.name for path in (batch.folder / "results").rglob("*")] == ["a", "traits.json"]


def test_columns_that_break_later_cost_a_finished_tree_nothing(tmp_path):
    """The refusal is no parameter that Snakemake compares: the features are not made again."""
    workspace = Workspace(tmp_path / "work")
    write_orbit(workspace.folder / "photos", 3)
    workspace.table("tree | photos | scale", "p | photos | none")
    features = "results/p/sfm/features.db"
    workspace.run(features)
    workspace.table("tree | photos | scale", "p | photos | marker")
    assert "Nothing to be done" in workspace.run(features)
    printed = workspace.run("results/p/sky_colors.npz", fails=True)
    assert "marker_dictionary and marker_sides_m are empty" in printed
    assert (workspace.folder / features).exists()
