"""Skeleton model, axes, folding and the files they go into."""

import networkx as nx
import numpy as np
import pytest

from cherrypicker.errors import StageError
from cherrypicker.formats.swc import write_skeleton_swc
from cherrypicker.skeleton import (
    Skeleton,
    axes,
    fold,
    read_skeleton,
    write_skeleton_graphml,
    write_skeleton_ply,
    write_topology_graphml,
)
from cherrypicker.skeleton.model import rooted_order


def line(start, end, n_nodes):
    """`n_nodes` points after `start` up to and with `end`."""
    steps = np.linspace(0, 1, n_nodes + 1)[1:, None]
    return np.asarray(start) + steps * (np.asarray(end) - np.asarray(start))


def y_tree(left_radius=0.038, right_radius=0.02):
    """A 1 m stem of 4 cm radius that forks into two arms of 1 m, 2 cm between nodes."""
    stem = np.vstack([[0.0, 0.0, 0.0], line((0, 0, 0), (0, 0, 1), 50)])
    left = line((0, 0, 1), (-0.3, 0, 1.95), 50)
    right = line((0, 0, 1), (0.5, 0, 1.85), 50)
    points = np.vstack([stem, left, right])
    parent = np.arange(-1, len(points) - 1)
    parent[101] = 50
    radius = np.concatenate(
        [np.full(51, 0.04), np.full(50, left_radius), np.full(50, right_radius)]
    )
    label = np.where(np.arange(151) <= 50, 1, 2)
    return Skeleton(points, parent, radius, label, {"gap": np.zeros(151, dtype=int)})


def test_trunk_goes_on_into_the_thickest_child():
    skeleton = y_tree()
    found = axes(skeleton)
    assert [(len(axis.nodes), axis.order, axis.parent, axis.attach) for axis in found] == [
        (101, 0, -1, -1),
        (50, 1, 0, 50),
    ]
    assert sorted(np.concatenate([axis.nodes for axis in found])) == list(range(151))


def test_trunk_ends_at_a_vase_fork():
    found = axes(y_tree(left_radius=0.025, right_radius=0.024))
    assert [(axis.order, axis.attach) for axis in found] == [(0, -1), (1, 50), (1, 50)]


def test_fold_keeps_root_junction_and_tips():
    skeleton = y_tree()
    graph = fold(skeleton)
    assert dict(graph.nodes(data="kind")) == {0: "root", 50: "junction", 100: "tip", 150: "tip"}
    assert sorted(order for *_, order in graph.edges(data="order")) == [0, 0, 1]
    assert graph.size("length") == pytest.approx(skeleton.edge_length.sum())
    paths = [path.split() for *_, path in graph.edges(data="path")]
    assert sorted(path[0] for path in paths) == ["0", "50", "50"]


def test_graphml_round_trip_and_attribute_types(tmp_path):
    skeleton = y_tree()
    write_skeleton_graphml(tmp_path / "skeleton.graphml", skeleton)
    write_topology_graphml(tmp_path / "topology.graphml", skeleton)
    again = read_skeleton(tmp_path / "skeleton.graphml")
    for name in ("points", "parent", "radius", "label"):
        np.testing.assert_array_equal(getattr(again, name), getattr(skeleton, name))
    np.testing.assert_array_equal(again.fields["gap"], skeleton.fields["gap"])
    topology = nx.read_graphml(tmp_path / "topology.graphml")
    kinds = {"0": "root", "50": "junction", "100": "tip", "150": "tip"}
    assert dict(topology.nodes(data="kind")) == kinds
    path = " ".join(map(str, [50, *range(101, 151)]))
    assert topology.edges["50", "150"]["path"] == path
    graph = nx.read_graphml(tmp_path / "skeleton.graphml")
    assert not graph.is_directed() and nx.is_tree(graph)
    assert graph.graph["root"] in graph
    node = graph.nodes[graph.graph["root"]]
    assert {type(node[key]) for key in ("x", "y", "z", "radius")} == {float}
    assert type(node["label"]) is int
    text = (tmp_path / "skeleton.graphml").read_text()
    assert 'edgedefault="undirected"' in text and 'attr.type="double"' in text


def test_equal_skeletons_give_equal_bytes(tmp_path):
    for run in ("a", "b"):
        skeleton = y_tree()
        write_skeleton_graphml(tmp_path / f"{run}.graphml", skeleton)
        write_skeleton_swc(tmp_path / f"{run}.swc", skeleton)
        write_skeleton_ply(tmp_path / f"{run}.ply", skeleton)
    for suffix in ("graphml", "swc", "ply"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_swc_and_ply_hold_every_edge(tmp_path):
    skeleton = y_tree()
    write_skeleton_swc(tmp_path / "s.swc", skeleton)
    rows = np.loadtxt(tmp_path / "s.swc")
    assert rows.shape == (151, 7)
    assert rows[0, 6] == -1 and (rows[1:, 6] < rows[1:, 0]).all()
    write_skeleton_ply(tmp_path / "s.ply", skeleton)
    open3d = pytest.importorskip("open3d")
    lines = open3d.io.read_line_set(str(tmp_path / "s.ply"))
    assert len(lines.points) == 151 and len(lines.lines) == 150


def test_reader_refuses_what_is_no_skeleton(tmp_path):
    with pytest.raises(StageError, match="missing"):
        read_skeleton(tmp_path / "none.graphml")
    graph = nx.Graph(root="0")
    graph.add_edge("0", "1")
    nx.write_graphml_xml(graph, tmp_path / "bare.graphml")
    with pytest.raises(StageError, match="not a skeleton"):
        read_skeleton(tmp_path / "bare.graphml")
    (tmp_path / "text.graphml").write_text("no xml")
    with pytest.raises(StageError, match="GraphML"):
        read_skeleton(tmp_path / "text.graphml")
    far = y_tree()
    far.points[5, 0] = 1e300
    write_skeleton_graphml(tmp_path / "far.graphml", far)
    with pytest.raises(StageError, match="not finite"):
        read_skeleton(tmp_path / "far.graphml")


def test_rooted_order_puts_parents_first():
    order, parent = rooted_order(4, np.array([[3, 1], [1, 0], [1, 2]]), 3)
    assert order[0] == 3 and parent[0] == -1
    assert (parent[1:] < np.arange(1, 4)).all()
    with pytest.raises(ValueError, match="edges"):
        rooted_order(4, np.array([[0, 1], [1, 2], [0, 2]]), 0)


def test_select_wants_parents():
    skeleton = y_tree()
    part = skeleton.select(np.arange(151) < 101)
    assert len(part) == 101 and part.n_children.max() == 1
    with pytest.raises(ValueError, match="parent"):
        skeleton.select(np.arange(151) != 10)
