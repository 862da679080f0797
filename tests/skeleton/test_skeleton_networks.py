"""Skeletons as networkx graphs, and folded."""

import networkx as nx
import numpy as np
import pytest

from cherrypicker.skeleton import (
    Skeleton,
    node_order,
    write_topology_graphml,
)
from cherrypicker.skeleton.networks import as_networkx


@pytest.fixture
def skeleton():
    """A stem with two laterals, one of which forks, and a lateral at the root."""
    rng = np.random.default_rng(0)
    parent = np.array([-1, 0, 1, 2, 3, 4, 2, 6, 7, 8, 7, 10, 0, 12])
    points = rng.normal(size=(len(parent), 3))
    fields = {"gap": np.arange(len(parent)) % 2, "n_points": np.arange(len(parent))}
    return Skeleton(points, parent, rng.random(len(parent)), np.ones(len(parent)), fields)


def test_a_skeleton_is_a_tree_of_its_nodes(skeleton):
    graph = as_networkx(skeleton)
    assert nx.is_tree(graph) and list(graph.nodes) == list(range(len(skeleton)))
    assert graph.graph == {"root": 0, "unit": "m", "frame": "metric"}
    assert graph.graph["root"] in graph
    assert graph.nodes[7]["x"] == skeleton.points[7, 0] and graph.nodes[7]["n_points"] == 7
    assert graph.edges[3, 2] == {"length": skeleton.edge_length[3], "gap": 1}


def test_folding_leaves_root_junctions_and_tips(skeleton, tmp_path):
    order, n_children = node_order(skeleton), skeleton.n_children
    write_topology_graphml(tmp_path / "topology.graphml", skeleton)
    found = nx.read_graphml(tmp_path / "topology.graphml", node_type=int)
    assert {*found} == {0, *np.flatnonzero(n_children != 1)}
    for node, data in found.nodes(data=True):
        kind = "junction" if n_children[node] else "tip"
        point = dict(zip("xyz", skeleton.points[node], strict=True))
        assert data == {**point, "kind": kind if node else "root"}
    assert (found.graph["unit"], found.graph["frame"]) == ("m", "metric")
    for *ends, edge in found.edges(data=True):
        path = [int(node) for node in edge["path"].split()]
        assert path[0] == min(ends) and path[-1] == max(ends)
        np.testing.assert_array_equal(skeleton.parent[path[1:]], path[:-1])
        assert edge["length"] == pytest.approx(skeleton.edge_length[path[1:]].sum())
        own = path[0] == 0 or order[path[0]] == order[path[1]]
        assert edge["radius_start"] == skeleton.radius[path[0] if own else path[1]]
        assert edge["radius_end"] == skeleton.radius[path[-1]]
        assert edge["order"] == order[path[-1]]
