import pytest
from workspace import PROJECT

from cherrypicker.batch.batch import read_batch
from cherrypicker.batch.scans import Scans
from cherrypicker.batch.trees import Tree, read_trees, series_of
from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml


@pytest.fixture
def table(tmp_path):
    def write(text, encoding="utf-8"):
        path = tmp_path / "trees.tsv"
        path.write_bytes(text.encode(encoding))
        return path

    return write


def test_absent_columns_and_empty_cells_take_their_defaults(table):
    (only,) = read_trees(table("tree\tphotos\tscale\nA-1\tphotos/A 1\t\n"))
    assert (only.tree, only.photos, only.scale, only.cloud_up) == ("A-1", "photos/A 1", "", "")
    assert only.is_photo_scan


def test_byte_order_mark_crlf_comments_and_blank_lines(table):
    text = "\ufefftree\tcloud\r\n# a comment\r\n\r\na\ta.ply\r\nb\tb.ply\r\n"
    assert [row.tree for row in read_trees(table(text))] == ["a", "b"]


def test_a_header_alone_is_an_empty_batch(table):
    assert read_trees(table("tree\tphotos\n")) == []


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "no header"),
        ("photos\nx\n", "'tree' is missing"),
        ("tree\n a\n", "'photos' and 'cloud'"),
        ("tree\tphoto\na\tx\n", "unknown column 'photo'; did you mean 'photos'"),
        ("tree,photos\na,x\n", "separated by tabs, not as 'tree,photos'"),
        ("tree  photos\na  x\n", "separated by tabs"),
        ("tree\tphotos\n../x\ty\n", "tree '../x'"),
        ("tree\tphotos\n..\ty\n", "does not start"),
        ("tree\tphotos\n\ty\n", "line 2"),
        ("tree\tphotos\na\t\n", "exactly one"),
        ("tree\tphotos\tcloud\na\tx\ty.ply\n", "exactly one"),
        ("tree\tphotos\na\tx\na\ty\n", "stands twice"),
        ("tree\tphotos\na\tx\nA\ty\n", "stands twice"),
        ("tree\tcloud\tcloud_unit\na\tx.ply\tinch\n", "'inch'"),
        ("tree\tcloud\tcloud_unit\na\tx.ply\t-1\n", "'-1'"),
        ("tree\tcloud\tcloud_up\na\tx.ply\tw\n", "no axis"),
        ("tree\tcloud\tscale\na\tx.ply\tmarker\n", "no photos"),
        ("tree\tphotos\tscale\na\tx\t0\n", "'0'"),
        ("tree\tphotos\tdate\na\tx\t3 May\n", "ISO date"),
        ("tree\tphotos\na\tx\tmore\n", "more cells"),
    ],
)
def test_a_bad_table_is_refused(table, text, reason):
    with pytest.raises(StageError, match=reason):
        read_trees(table(text))


def test_a_series_has_two_scans_and_a_folder_of_its_own():
    rows = [Tree(name, series=series) for name, series in (("a", "row <1>"), ("b", ""), ("c", "x"))]
    assert series_of(rows) == {}
    again = Tree("d", series="row <1>")
    assert series_of([*rows, again]) == {"row__1_": [rows[0], again]}
    with pytest.raises(StageError, match="share the folder 'row__1_'"):
        series_of([*rows, again, Tree("e", series="row (1)")])
    assert list(series_of([Tree("a", series=".."), Tree("b", series="..")])) == ["_"]


def test_photos_that_are_not_there_are_told_before_a_stage(tmp_path):
    table = {"trees": str(tmp_path / "trees.tsv")}
    (tmp_path / "full").mkdir()
    (tmp_path / "full/1.HEIC").touch()
    (tmp_path / "empty").mkdir()
    rows = [f"{name}\t{tmp_path / name}\tnone\n" for name in ("full", "empty", "gone")]
    (tmp_path / "trees.tsv").write_text("".join(["tree\tphotos\tscale\n", *rows]))
    schema = load_yaml(PROJECT / "workflow/schemas/config.schema.yaml")
    scans = Scans(read_batch(schema, table))
    assert scans.problem("full") == {}
    assert scans.problem("gone")["cause"] == "the folder of photos is missing"
    assert ".heic" in scans.problem("empty")["cause"]
