"""A digitised tree: read, brought onto ours, and set beside it limb by limb."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from finished_tree import small_skeleton, write_finished_tree
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from cherrypicker.accuracy.digitised import limb_measures, read_digitised, register
from cherrypicker.accuracy.measures import append_measures, read_measures
from cherrypicker.accuracy.places import Places
from cherrypicker.command.main import main
from cherrypicker.errors import StageError
from cherrypicker.files import read_json, write_json
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.formats.mtg import write_mtg
from cherrypicker.skeleton import Skeleton, axes, axis_of_node
from cherrypicker.traits.branches import axis_shapes

WIDER = 1.07
HEAD = "id,parent,x,y,z,diameter"
NAMES = ("height", "trunk_diameter", "branch_diameter", "branch_length", "branch_angle")


def moved(skeleton, seed=0):
    """The points turned about the vertical, tilted by two degrees and shifted."""
    rng = np.random.default_rng(seed)
    tilt = Rotation.from_rotvec(np.radians(2) * np.array([np.cos(seed), np.sin(seed), 0.0]))
    turn = tilt * Rotation.from_euler("z", rng.uniform(0, 360), degrees=True)
    return turn.apply(skeleton.points) + rng.normal(size=3)


def write_table(path, points, skeleton, head=HEAD, row="{},{},{:.7f},{:.7f},{:.7f},{:.7f}"):
    """The skeleton at other points, its diameters too wide."""
    rows = zip(skeleton.parent, points, 2 * WIDER * skeleton.radius, strict=True)
    text = [head, *(row.format(i, up, *at, wide) for i, (up, at, wide) in enumerate(rows))]
    path.write_text("\n".join(text) + "\n")
    return path


@pytest.mark.parametrize("seed", range(3))
def test_a_moved_tree_comes_back(tmp_path, seed):
    ours = small_skeleton()
    theirs = read_digitised(write_table(tmp_path / "a.csv", moved(ours, seed), ours))
    there, share, residual = register("a", theirs, ours)
    assert cKDTree(ours.points).query(there.skeleton.points)[0].max() < 1e-3
    assert share == pytest.approx(1.0) and residual < 1e-3
    axis_list = axes(ours)
    shapes = axis_shapes(replace(ours, radius=WIDER * ours.radius), axis_list)
    rows, n_left_out = limb_measures("a", there, Places(ours, axis_list, 0.1), "Ann")
    assert len(rows) == 2 + 3 * 4 and n_left_out == 0
    told = {name: [row for row in rows if row.quantity.short_name == name] for name in NAMES}
    for thick, long, angle in zip(*(told[name] for name in NAMES[2:]), strict=True):
        node = cKDTree(ours.points).query(thick.point)[1]
        index = axis_of_node(ours, axis_list)[node]
        nodes = axis_list[index].nodes
        assert node == nodes[len(nodes) // 2] and thick.order == axis_list[index].order
        assert thick.point == pytest.approx(ours.points[node], abs=1e-3)
        assert thick.value == pytest.approx(2 * WIDER * ours.radius[node], abs=1e-6)
        assert long.value == pytest.approx(shapes["length_m"][index], abs=1e-5)
        assert angle.value == pytest.approx(shapes["insertion_angle_deg"][index], abs=1e-2)
        assert thick.note == "digitised: a.csv"
    assert told["height"][0].value == pytest.approx(np.ptp(ours.points[:, 2]), abs=1e-3)
    middle = axis_list[0].nodes[30]
    assert told["trunk_diameter"][0].value == pytest.approx(
        2 * WIDER * ours.radius[middle], abs=1e-6
    )
    height = told["trunk_diameter"][0].place["height_m"]
    assert height == pytest.approx(ours.points[middle, 2] - 0.1, abs=1e-3)


def test_tables_of_other_habits(tmp_path):
    ours = small_skeleton()
    plain = read_digitised(write_table(tmp_path / "a.csv", ours.points, ours))
    row = "{}\t{}\t{:.7f}\t{:.7f}\t{:.7f}\t{:.7f}"
    mixed = write_table(
        *(tmp_path / "b.txt", 100 * ours.points, ours, HEAD.replace(",", "\t"), row)
    )
    text = mixed.read_text().replace(".", ",").replace("\t-1\t", "\t\t")
    mixed.write_text(text)
    other = read_digitised(mixed, "cm", "1")
    assert np.allclose(other.skeleton.points, plain.skeleton.points, atol=1e-6)
    assert np.allclose(other.skeleton.radius, plain.skeleton.radius)
    mixed.write_text(HEAD.replace("diameter", "radius") + "\n1,,0,0,0,0.2\n2,1,0,0,1,\n")
    skeleton = read_digitised(mixed).skeleton
    assert skeleton.radius.tolist() == [0.2, 0.2]
    assert read_digitised(mixed).is_measured.tolist() == [True, False]


def test_an_mtg_of_ours_reads_back(tmp_path):
    ours = write_finished_tree(tmp_path / "tree")
    tree = read_measured_tree(tmp_path / "tree")
    write_mtg(tmp_path / "tree.mtg", tree)
    read = read_digitised(tmp_path / "tree.mtg").skeleton
    off, node = cKDTree(ours.points).query(read.points)
    assert off.max() < 1e-8 and len(set(node)) == len(ours)
    assert node[0] == 0 and (node[read.parent[1:]] == ours.parent[node[1:]]).all()
    assert np.allclose(read.radius, tree.skeleton.radius[node], atol=1e-8)


def test_an_mtg_of_openaleas_habits(tmp_path):
    """Several vertices a line, laterals in columns, vertices without a place."""
    path = tmp_path / "apple.mtg"
    path.write_text(
        "CODE :\tFORM-A\nMTG:\nENTITY-CODE\t\t\tXX\tYY\tZZ\tTopDia\n# a remark\n"
        "/P1\n^/U94\t\t\t0\t0\t0\t37\n^/E1<<E35\t\t\t-2\t0\t825\t33\n"
        "\t+D94/E1\t\t20\t-23\t844\t13\n\t^<B95\n\t^/E1\t\t22\t-34\t858\n"
        "\t\t+D95/E1\t7\t-30\t863\t11\n^<E36\t\t\t0\t0\t1000\t28\n"
    )
    tree = read_digitised(path, "mm", "0.001").skeleton
    assert tree.points[:, 2] == pytest.approx([0, 0.825, 0.844, 0.858, 0.863, 1.0])
    assert tree.parent.tolist() == [-1, 0, 1, 2, 3, 1]
    assert tree.radius.tolist() == pytest.approx([0.0185, 0.0165, 0.0065, 0.0065, 0.0055, 0.014])


def test_another_tree_and_a_wrong_unit_are_refused(tmp_path):
    ours = small_skeleton()
    path = write_table(tmp_path / "a.csv", moved(ours), ours)
    with pytest.raises(
        StageError, match="tree a: it reaches 1.4e.03 m .* is the unit right"
    ) as caught:
        register("a", read_digitised(path, "1000"), ours)
    assert (caught.value.file, caught.value.key) == (str(path), "--unit")
    rng = np.random.default_rng(3)
    points, parent = [np.zeros(3)], [-1]
    for turn in rng.uniform(0, 2 * np.pi, 5):  # limbs from the ground on
        way = np.array([0.7 * np.cos(turn), 0.7 * np.sin(turn), 0.7])
        parent += [0, *range(len(points), len(points) + 24)]
        points += list(np.arange(1, 26)[:, None] * 0.06 * way)
    other = Skeleton(points, parent, np.full(len(points), 0.01), np.ones(len(points)))
    path = write_table(tmp_path / "b.csv", other.points, other)
    with pytest.raises(StageError, match=r"tree a: \d+% of its length lies within 5 cm") as caught:
        register("a", read_digitised(path), ours)
    assert caught.value.file == str(path)


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (["1,-1,0,0,0,1", "2,1,0,0,1,1", "3,-1,0,0,2,1"], "line 2, 4.; the root alone"),
        (["1,-1,0,0,0,1", "2,3,0,0,1,1", "3,2,0,0,2,1"], "from line 3 on parents lead in a circle"),
        (["1,-1,0,0,0,1", "2,1,0,0,1,1", "2,1,0,0,2,1"], "id 2 stands there twice; give it"),
        (["1,-1,0,0,0,", "2,1,0,0,1,"], "no node has a diameter; measure some"),
        (["1,-1,0,0,0,1", "2,1,0,0,one,1"], "row 3: 'one' is no number"),
    ],
)
def test_what_is_no_tree_names_file_and_line(tmp_path, rows, told):
    path = tmp_path / "a.csv"
    path.write_text("\n".join([HEAD, *rows]))
    with pytest.raises(StageError, match=told) as caught:
        read_digitised(path)
    assert caught.value.file == str(path)


def test_what_cannot_be_read_is_told(tmp_path):
    path = tmp_path / "a.mtg"
    with pytest.raises(StageError, match="cannot be read"):
        read_digitised(path)
    path.write_text("CODE:\tFORM-A\n")
    with pytest.raises(StageError, match="no line begins with TOPO"):
        read_digitised(path)
    path.write_text("MTG:\nTOPO\t\tXX\tYY\tZZ\n/P1\n")
    with pytest.raises(StageError, match="line 2: the MTG has no feature TopDiameter or"):
        read_digitised(path)
    for option, units in (("--unit", ["mmm"]), ("--diameter_unit", ["m", "-1"])):
        with pytest.raises(StageError, match="is no unit of length; give m, cm, mm") as caught:
            read_digitised(path, *units)
        assert caught.value.key == option


def test_the_command_prints_and_appends_once(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config").mkdir()
    (tmp_path / "config/trees.tsv").write_text("tree\tcloud\nsmall\tnone.ply\n")
    ours = write_finished_tree(tmp_path / "results/small")
    traits = read_json("results/small/traits.json") | {"foot": [0, 0, 0.0]}
    write_json("results/small/traits.json", traits)
    write_table(tmp_path / "a.csv", moved(ours), ours)
    call = ["measures", "a.csv", "--tree", "small", "--who", "Ann"]
    assert main(call) == 0
    shown = capsys.readouterr()
    assert "100% of its length within 5 cm" in shown.err
    rows = list(csv.DictReader(shown.out.splitlines()))
    assert len(rows) == 14 and {row["who"] for row in rows} == {"Ann"}
    assert main([*call, "--append"]) == 0
    table = tmp_path / "config/measures.csv"
    assert table.read_text() == shown.out
    assert main([*call, "--append"]) == 1
    assert "14 of 14 rows are there already, the first in line 2" in capsys.readouterr().err
    assert main([*call, "--unit", "ell"]) == 1
    assert "'ell' is no unit of length" in capsys.readouterr().err


def test_rows_go_into_a_table_as_it_stands(tmp_path):
    ours = small_skeleton()
    theirs = read_digitised(write_table(tmp_path / "a.csv", ours.points, ours))
    rows, _ = limb_measures("a", theirs, Places(ours, axes(ours), 0.0))
    table = tmp_path / "measures.csv"
    start = (
        "\ufeff# ours\r\ntree;trait;value;unit;note;height_m;order;x_m;y_m;z_m\r\nb;height;2,3;m"
    )
    table.write_text(start, newline="")
    append_measures(table, rows)
    assert table.read_bytes().startswith(start.encode())
    first, *read = read_measures(table)
    assert first.value == 2.3
    assert [(row.value, row.place) for row in read] == [(row.value, row.place) for row in rows]
    table.write_text("tree,trait,value,unit\n")
    with pytest.raises(StageError, match="the table has no column x_m, y_m, z_m, order, height_m"):
        append_measures(table, rows)
