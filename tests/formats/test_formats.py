"""Exports read back by readers of the formats, or by this test after their grammar."""

import csv
import json
import re

import laspy
import numpy as np
import pytest
import trimesh
from finished_tree import WIDER, small_skeleton, surface_cloud, write_finished_tree

from cherrypicker.errors import StageError
from cherrypicker.files import write_json, write_text
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.formats.table import FORMATS
from cherrypicker.pointcloud import read_cloud
from cherrypicker.skeleton import axes
from cherrypicker.traits.branches import branch_rows, branches_csv
from cherrypicker.traits.support import branch_cloud


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A finished tree's folder with every export, its skeleton and its traits."""
    folder = tmp_path_factory.mktemp("results") / "small"
    skeleton = write_finished_tree(folder)
    for name, kind in FORMATS.items():
        kind.write(folder / f"{name}{kind.suffix}", read_measured_tree(folder))
    return folder, skeleton, json.loads((folder / "traits.json").read_text())


def exported(tree, name):
    return tree[0] / f"{name}{FORMATS[name].suffix}"


def frustum_sum(start, end, radius):
    return float((np.pi * radius**2 * np.linalg.norm(end - start, axis=1)).sum())


def test_treeqsm_table_is_one_that_rtwig_takes(tree):
    _, skeleton, traits = tree
    with open(exported(tree, "treeqsm-csv"), newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert {"parent", "extension", "branch", "BranchOrder"} <= rows[0].keys()  # rTwig's own test
    value = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    ids = np.arange(1, len(rows) + 1)
    assert value["parent"][0] == 0 and (value["parent"][1:] > 0).all()
    assert (value["parent"] < ids).all()
    start, axis = (np.stack([value[f"{n}.{c}"] for c in "xyz"], 1) for n in ("start", "axis"))
    assert np.allclose(np.linalg.norm(axis, axis=1), 1.0, atol=1e-6)
    end = start + value["length"][:, None] * axis
    within = value["PositionInBranch"] > 1
    above = value["parent"][within].astype(int) - 1
    assert np.allclose(end[above], start[within], atol=1e-6)
    assert (value["parent"][within] == ids[within] - 1).all()
    assert (value["extension"][above] == ids[within]).all()
    assert value["length"].sum() == pytest.approx(traits["total_length_m"], abs=1e-6)
    assert frustum_sum(start, end, value["radius"]) == pytest.approx(
        traits["wood_volume_m3"], rel=1e-4
    )
    assert value["BranchOrder"].max() == 2 and len(set(value["branch"])) == 5
    is_seen = value["branch"] == 2
    assert (value["radius"] == value["UnmodRadius"])[~is_seen].all()
    assert (value["radius"] / value["UnmodRadius"])[is_seen] == pytest.approx(WIDER, rel=0.03)


def test_radii_are_those_that_the_photos_told(tree):
    measured = read_measured_tree(tree[0])
    ratio = measured.skeleton.radius / small_skeleton().radius
    seen = measured.axis_list[1].nodes
    assert (ratio[seen] > 1 + 0.7 * (WIDER - 1)).all() and (ratio[seen] < WIDER + 0.02).all()
    assert np.delete(ratio, seen) == pytest.approx(1.0, rel=2e-3)


@pytest.mark.parametrize(
    "other",
    [{}, {"widths": [0.01]}, {"branch_id": 77, "widths": [0.01]}, {"branch_id": 2, "widths": []}],
)
def test_photos_of_another_run_or_a_version_before_are_refused_by_name(tmp_path, other):
    write_finished_tree(tmp_path / "old")
    write_json(tmp_path / "old/photo_check.json", {"branches": [{"branch_id": 1} | other]})
    with pytest.raises(StageError, match="run check_photos and .* again.*photo_check.json"):
        read_measured_tree(tmp_path / "old")


def test_photos_of_a_tree_that_is_now_from_a_cloud_tell_nothing(tmp_path):
    skeleton = write_finished_tree(tmp_path / "tree")
    rows = branch_rows(skeleton, axes(skeleton), 0.0)
    write_text(tmp_path / "tree/branches.csv", branches_csv(rows))
    assert (read_measured_tree(tmp_path / "tree").skeleton.radius == skeleton.radius).all()


def mtg_vertices(text):
    """Vertices of an MTG after the published grammar: label, parent, relation, cells."""
    sections = re.split(r"^(CODE|CLASSES|DESCRIPTION|FEATURES|MTG):", text, flags=re.MULTILINE)
    assert sections[1::2] == ["CODE", "CLASSES", "DESCRIPTION", "FEATURES", "MTG"]
    features = [line.split("\t") for line in sections[8].strip().splitlines()]
    assert features.pop(0) == ["NAME", "TYPE"]
    head, *lines = sections[10].strip().splitlines()
    names = head.split("\t")
    assert names[0] == "TOPO" and names[-len(features) :] == [name for name, _ in features]
    n_columns = len(names) - len(features)
    found, last = [], {}  # last vertex of each scale by column
    for line in lines:
        cells = line.split("\t") + [""] * len(names)
        column = next(i for i in range(n_columns) if cells[i])
        code = re.fullmatch(r"(\^?)([/<+])([PAS])(\d+)", cells[column])
        assert code and not any(cells[i] for i in range(column + 1, n_columns)), line
        scale = "PAS".index(code[3])
        origin = column if code[1] else column - 1
        parent = None
        if code[2] in "<+":
            # A lateral axis leaves the axis that the column to the left is in
            parent = last[origin, scale]
        elif scale == 2 and column:
            parent = last[column - 1, 2]  # the first segment of a lateral hangs on what bears it
        number = len(found)
        found.append((cells[column].lstrip("^"), parent, code[2], cells[n_columns : len(names)]))
        for deeper in [key for key in last if key[0] > column]:
            del last[deeper]
        last[column, scale] = number
    return found, [name for name, _ in features]


def test_mtg_has_every_node_and_the_length(tree):
    _, skeleton, traits = tree
    vertices, names = mtg_vertices(exported(tree, "mtg").read_text())
    segments = [vertex for vertex in vertices if "S" in vertex[0]]
    assert len(segments) == len(skeleton)
    assert sum("A" in vertex[0] for vertex in vertices) == len(axes(skeleton))
    lengths = [float(cells[names.index("Length")]) for *_, cells in segments]
    assert sum(lengths) == pytest.approx(traits["total_length_m"], abs=1e-6)
    node = {row: int(vertex[0][2:]) - 1 for row, vertex in enumerate(vertices) if "S" in vertex[0]}
    parents = {node[row]: node.get(vertices[row][1], -1) for row in node}
    assert [parents[i] for i in range(len(skeleton))] == skeleton.parent.tolist()


def test_mtg_tells_diameters(tree):
    vertices, names = mtg_vertices(exported(tree, "mtg").read_text())
    column = names.index("TopDiameter")
    told = {int(name[2:]) - 1: float(cells[column]) for name, *_, cells in vertices if "S" in name}
    trunk = axes(tree[1])[0].nodes
    assert [told[node] for node in trunk] == pytest.approx(2 * tree[1].radius[trunk], rel=2e-3)


def test_mtg_is_read_by_openalea(tree):
    io = pytest.importorskip("openalea.mtg.io")
    graph = io.read_mtg_file(str(exported(tree, "mtg")))
    assert graph.nb_vertices(scale=3) == len(tree[1])
    total = sum(float(value) for value in graph.property("Length").values())
    assert total == pytest.approx(tree[2]["total_length_m"], abs=1e-6)


def test_qsm_has_libqsm_layout(tree):
    data = exported(tree, "qsm").read_bytes()
    head, _, body = data.partition(b"DATA binary\n")
    keys = dict(line.split(" ", 1) for line in head.decode().splitlines() if line[0] != "#")
    assert (keys["SIGNATURE"], keys["VERSION"], keys["FORMAT"]) == ("QSMF", "1.0", "2")
    n_nodes, n_edges = int(keys["NODES"]), int(keys["EDGES"])
    assert n_edges == n_nodes - 1 and len(body) == 12 * n_nodes + 26 * n_edges
    nodes = np.frombuffer(body, "<f4", 3 * n_nodes).reshape(-1, 3)
    nodes = nodes + np.array([float(keys[f"{axis}_OFFSET"]) for axis in "XYZ"])
    kinds = [("source", "<u4"), ("target", "<u4"), ("radius", "<f4"), ("quality", "u1")]
    kinds += [("axis", "<u4"), ("order", "u1"), ("beyond", "<f4"), ("from_root", "<f4")]
    edges = np.frombuffer(body, np.dtype(kinds), n_edges, 12 * n_nodes)
    start, end = nodes[edges["source"] - 1], nodes[edges["target"] - 1]
    length = np.linalg.norm(end - start, axis=1)
    assert length.sum() == pytest.approx(tree[2]["total_length_m"], abs=1e-5)
    assert frustum_sum(start, end, edges["radius"]) == pytest.approx(
        tree[2]["wood_volume_m3"], rel=1e-4
    )
    assert edges["axis"].min() == edges["order"].min() == 1
    tips = ~np.isin(edges["target"], edges["source"])
    assert (edges["beyond"][tips] == 0).all()
    farthest = edges["from_root"] + length
    assert farthest.max() == pytest.approx(tree[1].distance_to_root().max(), abs=1e-5)


def test_treefile_has_raycloudtools_form(tree):
    comment, names, line = exported(tree, "treefile").read_text().splitlines()
    assert comment.startswith("#") and names.startswith("x,y,z,radius,parent_id")
    per_segment = names.count(",") + 1
    values = np.array([float(cell) for cell in line.split(",")])
    assert len(values) % per_segment == 0
    segments = values.reshape(-1, per_segment)
    parent = segments[:, 4].astype(int)
    assert parent[0] == -1 and (parent[1:] < np.arange(1, len(parent))).all()
    start, end = segments[parent[1:], :3], segments[1:, :3]
    length = np.linalg.norm(end - start, axis=1).sum()
    assert length == pytest.approx(tree[2]["total_length_m"], abs=1e-4)
    assert frustum_sum(start, end, segments[1:, 3]) == pytest.approx(
        tree[2]["wood_volume_m3"], rel=1e-3
    )


@pytest.mark.parametrize("name", ["obj", "gltf"])
def test_meshes_are_closed_and_hold_the_wood_volume(tree, name):
    mesh = trimesh.load(exported(tree, name), force="mesh")
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert len(mesh.split()) == len(axes(tree[1]))
    assert mesh.volume == pytest.approx(tree[2]["wood_volume_m3"], rel=2e-3)


def test_gltf_stands_upright_and_names_its_branches(tree):
    scene = trimesh.load(exported(tree, "gltf"))
    assert {f"branch_{i}" for i in range(5)} <= set(scene.graph.nodes)
    height = np.ptp(tree[1].points[:, 2])
    assert np.ptp(scene.bounds[:, 1]) == pytest.approx(height, abs=0.05)  # glTF's up is y
    assert scene.bounds[0, 1] == pytest.approx(0.0, abs=0.05)  # it stands on its root


def test_las_keeps_class_and_branch(tree):
    cloud = read_cloud(tree[0] / "segmented.ply")
    las = laspy.read(exported(tree, "las"))
    assert np.abs(np.asarray(las.xyz) - cloud.points).max() < 1e-4
    assert (np.asarray(las["label"]) == cloud["label"]).all()
    ground = cloud["label"] == 0
    assert (np.asarray(las.classification)[ground] == 2).all()
    assert (np.asarray(las["branch_id"])[ground] == -1).all()


def test_points_go_to_the_tube_that_they_lie_on():
    skeleton = small_skeleton()
    cloud, owner = surface_cloud(skeleton)
    cloud.points[np.argmax(owner >= 0)] = [3.0, 0.0, 1.0]
    wood = branch_cloud(cloud, skeleton, axes(skeleton))
    assert (wood["source"] == np.flatnonzero(owner >= 0)).all()
    assert np.mean(wood["branch_id"] == owner[owner >= 0]) > 0.98
    assert wood["branch_id"][0] == -1


def test_tables_of_two_runs_are_refused(tree, tmp_path):
    for name in ("skeleton.graphml", "branches.csv"):
        (tmp_path / name).write_bytes((tree[0] / name).read_bytes())
    with open(tmp_path / "branches.csv", "a") as stream:
        stream.write("9,0,1,0.1,0.1,0.01,0.01,0,0,0,0.01" + "," * 20 + "\n")
    with pytest.raises(StageError, match="measure_traits"):
        read_measured_tree(tmp_path)
