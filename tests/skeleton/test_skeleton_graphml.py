"""GraphML of networkx, read as columns."""

import networkx as nx
import pytest

from cherrypicker.skeleton.graphml import GraphColumns, read_graphml


def columns(kind="a tip"):
    return GraphColumns(
        {"root": "0", "unit": "m"},
        ["0", "1", "2", "7"],
        {"x": [0.5, -1e-9, 3e22, float("inf")], "label": [1, 2, 2, 3], "kind": [kind] * 4},
        [("0", "1"), ("7", "1"), ("0", "2")],
        {"length": [0.25, 1.0, 0.1], "gap": [0, 1, 0]},
    )


def as_networkx(graph):
    other = nx.Graph(**graph.attributes)
    for row, name in enumerate(graph.ids):
        other.add_node(name, **{key: values[row] for key, values in graph.nodes.items()})
    for row, (a, b) in enumerate(graph.edges):
        other.add_edge(a, b, **{key: values[row] for key, values in graph.edge_data.items()})
    return other


def write_by_networkx(graph, path, **options):
    nx.write_graphml_xml(as_networkx(graph), str(path), **options)


def test_what_was_written_is_read(tmp_path):
    write_by_networkx(columns(), tmp_path / "nx.graphml", prettyprint=True, named_key_ids=True)
    found = read_graphml(tmp_path / "nx.graphml")
    assert found.edges == [("0", "1"), ("0", "2"), ("1", "7")]  # by their first nodes
    assert found.edge_data == {"length": [0.25, 0.1, 1.0], "gap": [0, 0, 1]}
    expected = columns()
    assert (found.ids, found.nodes) == (expected.ids, expected.nodes)
    assert found.attributes == expected.attributes
    assert [type(values[0]) for values in found.nodes.values()] == [float, int, str]


def test_other_layouts_are_read_as_well(tmp_path):
    write_by_networkx(columns("a & b"), tmp_path / "flat.graphml", named_key_ids=True)
    found = read_graphml(tmp_path / "flat.graphml")
    assert found.nodes == columns("a & b").nodes
    assert found.edge_data["gap"] == [0, 0, 1]
    assert found.attributes == {"root": "0", "unit": "m"}
    (tmp_path / "lone.graphml").write_bytes(
        (tmp_path / "flat.graphml").read_bytes().replace(b'<data key="label">2</data>', b"", 1)
    )
    lone = read_graphml(tmp_path / "lone.graphml")
    assert set(found.nodes) - set(lone.nodes) == {"label"}  # one node lacks it


def test_a_single_node(tmp_path):
    graph = GraphColumns({"root": "0"}, ["0"], {"x": [1.0]}, [], {})
    write_by_networkx(graph, tmp_path / "nx.graphml", prettyprint=True, named_key_ids=True)
    assert read_graphml(tmp_path / "nx.graphml") == graph


def test_what_is_no_graphml_is_a_value_error(tmp_path):
    (tmp_path / "own.graphml").write_text("<graphml/>")
    with pytest.raises(ValueError, match="graphml"):
        read_graphml(tmp_path / "own.graphml")
