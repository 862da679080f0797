"""What spoilt files taught: promises that no file holds, and values that are not what they seem."""

import json
import pickle
import struct
import zlib

import jinja2
import numpy as np
import pytest
from finished_tree import small_skeleton, surface_cloud
from fuzz_bench import Bench
from fuzz_clouds import READERS as CLOUD_READERS
from PIL import Image

from cherrypicker.accuracy.measures import read_measures
from cherrypicker.accuracy.places import Places
from cherrypicker.batch.benchmarks import read_benchmark
from cherrypicker.batch.rows import names_found
from cherrypicker.batch.trees import read_trees
from cherrypicker.errors import StageError
from cherrypicker.files import is_number, parse_yaml, read_json
from cherrypicker.intake.clouds import import_cloud
from cherrypicker.intake.prepare import size_of_capture
from cherrypicker.lens import read_model
from cherrypicker.photos import read_photo
from cherrypicker.skeleton import axes
from cherrypicker.skeleton.csv_table import read_skeleton_csv
from cherrypicker.skeleton.edits import read_edits
from cherrypicker.traits.branches import read_branches
from cherrypicker.traits.measure import measure_traits

FILES = {reader.name: reader.make for reader in CLOUD_READERS}
(LAS,) = (reader for reader in CLOUD_READERS if reader.name == "las")


def overwrite(path, place, form, value):
    content = bytearray(path.read_bytes())
    struct.pack_into(form, content, place, value)
    path.write_bytes(content)
    return path


def png_of(folder):
    Image.new("L", (40, 30)).save(folder / "a.png")
    content = (folder / "a.png").read_bytes()
    head = b"IHDR" + struct.pack(">II", 60_000, 60_000) + content[24:29]
    content = content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:]
    (folder / "a.png").write_bytes(content)
    return folder / "a.png"


def las_of(folder, name, place, form, value):
    FILES["las"](folder)
    return overwrite(folder / name, place, form, value)


def ascii_ply_of(folder):
    lines = ["ply", "format ascii 1.0", f"element vertex {2**40}"]
    lines += [f"property float {axis}" for axis in "xyz"] + ["end_header", "0 0 1", "0 1 0", ""]
    (folder / "a.ply").write_text("\n".join(lines))
    return folder / "a.ply"


def model_of(folder, name, place, form, value):
    FILES["model"](folder)
    return overwrite(folder / name, place, form, value).parent


@pytest.mark.parametrize(
    ("read", "make"),
    [
        (read_photo, png_of),
        (size_of_capture, png_of),
        (import_cloud, ascii_ply_of),
        (import_cloud, lambda folder: las_of(folder, "1.2.las", 107, "<I", 2**32 - 1)),
        (import_cloud, lambda folder: las_of(folder, "1.2.las", 100, "<I", 2**31)),
        (import_cloud, lambda folder: las_of(folder, "1.4.las", 247, "<Q", 2**40)),
        (read_model, lambda folder: model_of(folder, "images.bin", 0, "<Q", 2**40)),
        (read_model, lambda folder: model_of(folder, "points3D.bin", 8 + 43, "<Q", 2**33)),
        (read_model, lambda folder: model_of(folder, "frames.bin", 0, "<Q", 2**62)),
    ],
)
def test_a_header_that_promises_too_much_is_refused(tmp_path, read, make):
    path = make(tmp_path)
    with pytest.raises(StageError, match=r"promises|cut short") as caught:
        read(path)
    assert caught.value.file.startswith(str(tmp_path))


def test_records_after_the_points_are_not_read(tmp_path):
    whole = import_cloud(FILES["las"](tmp_path)[1])
    cloud = import_cloud(las_of(tmp_path, "1.4.las", 243, "<I", 2**31))
    np.testing.assert_array_equal(cloud.points, whole.points)


@pytest.mark.parametrize("where", ["table", "layer"])
def test_laz_chunks_that_are_not_there_are_refused(tmp_path, where):
    """The decoder, which would take memory for them, cannot be stopped: it ends the process."""
    FILES["las"](tmp_path)
    path = tmp_path / "1.4.laz"
    content = path.read_bytes()
    (start,) = struct.unpack_from("<I", content, 96)
    (table,) = struct.unpack_from("<q", content, start)
    with pytest.raises(StageError, match="promises chunks"):
        # After the table's place, the first point and the number of points, the layers' lengths
        place = table + 4 if where == "table" else start + 8 + 36 + 4
        import_cloud(overwrite(path, place, "<I", 2**32 - 1))


def test_a_laz_chunk_of_two_billion_points_takes_no_memory_for_them(tmp_path):
    """A decoder that makes room for a whole chunk ends the process, so another one reads."""
    FILES["las"](tmp_path)
    path = tmp_path / "1.4.laz"
    content = bytearray(path.read_bytes())
    record = content.index(b"laszip encoded") + 52  # after the rest of its head
    assert struct.unpack_from("<I", content, record + 12) == (50_000,)
    struct.pack_into("<I", content, record + 12, 2**31)
    bench = Bench()
    try:
        assert bench.faults(LAS, path, bytes(content)) == ""
    finally:
        bench.stop()


def test_plain_small_pictures_keep_their_promises(tmp_path):
    """One colour packs as well as pictures can."""
    for mode in ("1", "L", "RGB"):
        for suffix in ("png", "tif", "jpg"):
            path = tmp_path / f"{mode}.{suffix}"
            Image.new(mode, (2000, 1500)).save(path)
            assert read_photo(path).shape == (1500, 2000, 3)


@pytest.mark.parametrize(
    "text",
    [
        30 * "[" + 30 * "]",
        30 * "{a: " + "1" + 30 * "}",
        "a: &a [1, 1]\nb: &b [*a, *a]\nc: [*b, *b]",
        "a: &a {x: 1}\nb: &b {<<: *a, y: [*a]}",
    ],
)
def test_yaml_that_is_larger_than_it_looks_is_refused(text):
    with pytest.raises(ValueError, match="deeper|inside another"):
        parse_yaml(text)


@pytest.mark.parametrize("text", ["a: 1\nb: 2\na: {c: 3}", "x: {a: 1,\n b: 2,\n a: 1}"])
def test_a_key_that_stands_twice_is_refused(text):
    with pytest.raises(ValueError, match="'a' stands a second time in line 3"):
        parse_yaml(text)


def test_plain_anchors_are_read():
    assert parse_yaml("a: &a {x: 1}\nb: *a\nc: {<<: *a, y: 2}")["c"] == {"x": 1, "y": 2}


@pytest.mark.parametrize(
    "text", ["2026-02-30", "!!int ''", "!!bool x", "!!timestamp x", "9" * 5000, "1:" * 300 + "1.5"]
)
def test_a_value_that_does_not_fit_its_tag_is_refused(text):
    with pytest.raises(ValueError):
        parse_yaml(f"a: {text}")


def test_true_is_no_length(tmp_path):
    assert is_number(1) and is_number(0.5) and not is_number(True)
    assert not is_number(10**400) and not is_number(float("nan")) and not is_number("1")
    for text in ("cut: {at: [0, yes, 1]}", "{cut: {at: [0, 0, 1]}, tolerance_m: true}"):
        (tmp_path / "a.yaml").write_text(f"edits:\n  - {text}\n")
        with pytest.raises(StageError, match="number"):
            read_edits(tmp_path / "a.yaml")


def test_an_error_is_one_line_that_can_be_read(tmp_path):
    path = tmp_path / "trees.tsv"
    path.write_text("tree\tphotos\t\x1b[2Jowned\n")
    with pytest.raises(StageError) as caught:
        read_trees(path)
    assert str(caught.value).isprintable() and "owned" in str(caught.value)
    path.write_text(f"tree\tphotos\t{50_000 * 'x'}\n")
    with pytest.raises(StageError) as caught:
        read_trees(path)
    assert len(str(caught.value)) < 3000
    path.write_text("tree\tphotos\na\tphotos\0\n")
    with pytest.raises(StageError, match="line 2, tree 'a': a cell holds a control character"):
        read_trees(path)


@pytest.mark.parametrize(
    ("read", "head", "row"),
    [
        (read_trees, "tree\tphotos", "a\t{}"),
        (read_measures, "tree,trait,value,unit,who", "a,height,2,m,{}"),
        (read_branches, "id", "{}"),
        (read_skeleton_csv, "id,parent,x,y,z,radius,label", "1,-1,0,0,0,1,{}"),
        (read_benchmark, "s\tcpu_time\tmax_rss", "1\t1\t{}"),
    ],
)
def test_a_cell_longer_than_tables_have_is_refused(tmp_path, caplog, read, head, row):
    path = tmp_path / "a.csv"
    path.write_text(f"{head}\n{row.format('1' * 200_000)}\n")
    if read is read_benchmark:
        assert read(path) is None and "field limit" in caplog.text
        return
    with pytest.raises(StageError, match="field limit") as caught:
        read(path)
    assert caught.value.file == str(path)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        *(("skeleton", f'"{key}">1<', f'"{key}">{2**64}<') for key in ("label", "gap", "n_points")),
        ("skeleton", 'attr.name="x" attr.type="double"', 'attr.name="x" attr.type="string"'),
    ],
)
def test_a_graph_whose_numbers_are_none_is_refused(tmp_path, name, old, new):
    (reader,) = (reader for reader in CLOUD_READERS if reader.name == name)
    (path,) = reader.make(tmp_path)
    text = path.read_text()
    assert old in text
    text = text.replace(old, new)
    path.write_text(text.replace(">0.3<", ">far<") if "string" in new else text)
    with pytest.raises(StageError) as caught:
        reader.read(path)
    assert caught.value.file == str(path)


def test_a_record_without_a_key_is_named(tmp_path):
    (tmp_path / "scale.json").write_text('{"scale": 1, "markers": [{"id": 7}]}')
    record = read_json(tmp_path / "scale.json")
    assert record == {"scale": 1, "markers": [{"id": 7}]} and record.get("unit") is None
    for look in (lambda: record["unit"], lambda: record["markers"][0]["corners"]):
        with pytest.raises(StageError, match="the record has no") as caught:
            look()
        assert caught.value.file == str(tmp_path / "scale.json")
    assert json.loads(json.dumps(record)) == record == pickle.loads(pickle.dumps(record))
    assert "unit: none" in jinja2.Template("unit: {{ r.unit or 'none' }}").render(r=record)
    (tmp_path / "scale.json").write_text(100_000 * "[")
    with pytest.raises(StageError, match="not valid JSON"):
        read_json(tmp_path / "scale.json")


@pytest.mark.parametrize(
    "text",
    [
        "{",
        '{"trees": [{"n": 1}]}',
        '{"trees": [{"number": 1e999}]}',
        '{"trees": [{"number": 0}]}',
        '{"trees": 3}',
    ],
)
def test_a_broken_list_of_trees_stops_its_own_scan_alone(tmp_path, monkeypatch, caplog, text):
    (tmp_path / "results/row").mkdir(parents=True)
    (tmp_path / "results/row/trees.json").write_text(text)
    monkeypatch.chdir(tmp_path)
    assert names_found("row") == []
    assert "tree row" in caplog.text and "trees.json is broken; delete it" in caplog.text


@pytest.mark.parametrize("order", [1, 2])
def test_a_branch_of_no_length_costs_the_others_nothing(order):
    whole, spoilt = small_skeleton(), small_skeleton()
    lost = next(axis for axis in axes(spoilt)[::-1] if axis.order == order)
    spoilt.points[lost.nodes] = spoilt.points[lost.attach]
    middle = whole.points[90]
    told = [Places(tree, axes(tree), 0.0).at_point(middle) for tree in (whole, spoilt)]
    assert told[0] is not None and told[1].diameter == pytest.approx(told[0].diameter)
    cloud, _ = surface_cloud(whole)
    traits, _ = measure_traits(spoilt, cloud)
    assert all(np.isfinite(value) for value in traits.values() if isinstance(value, float))
